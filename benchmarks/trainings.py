# SPDX-License-Identifier: Apache-2.0
"""trainings.py: commands of scripts that train many avatars at once, and means over seeds."""
import contextlib
import os
import pathlib
import queue
import statistics
import subprocess

# Options of `rye flaw`: what trackers are off by, without eyeball centres.
EXPRESSION = ["--expression", "0.06", "--expression-share", "0.5"]
POSE = ["--pose", "0.6,1"]
LANDMARKS = ["--landmarks", "1.5"]
TRACK = EXPRESSION + POSE + LANDMARKS


def add_training_options(parser):
    parser.add_argument("--preset", default="cpu")
    parser.add_argument("--config", type=pathlib.Path, help="fields that differ from the preset's")
    parser.add_argument("--jobs", type=int, default=1, help="trainings at once")
    parser.add_argument("--devices", type=int, default=0, help="CUDA devices to spread the jobs over")


class Failed(Exception):
    """A command that failed; the text names its log."""


def call(log, env, *command):
    """Calls a command; its output is added to a log."""
    with open(log, "a") as out:
        out.write("$ " + " ".join(str(c) for c in command) + "\n")
        out.flush()
        if subprocess.call([str(c) for c in command], stdout=out, stderr=out, env=env) != 0:
            raise Failed(f"{' '.join(str(c) for c in command[:2])} failed; see {log}")


def once(path, log, env, *command):
    """Calls a command that makes `path`, unless it is there."""
    if not path.exists():
        call(log, env, *command)


class Slots:
    """Room for as many trainings at once as there are jobs, spread over the devices; 0: as they are."""

    def __init__(self, jobs, devices):
        self.devices, self.free = devices, queue.Queue()
        for i in range(jobs):
            self.free.put(i)

    @contextlib.contextmanager
    def environment(self):
        """Waits for room; the value is the environment of the commands."""
        slot = self.free.get()
        try:
            yield dict(os.environ, **({"CUDA_VISIBLE_DEVICES": str(slot % self.devices)} if self.devices else {}))
        finally:
            self.free.put(slot)


def shown(values, digits, unit):
    """The mean of a column, with its sample standard deviation if there are several values."""
    if None in values:
        return "none"
    text = f"{statistics.mean(values):.{digits}f}"
    if len(values) > 1:
        text += f" ± {statistics.stdev(values):.{digits}f}"
    return text + unit
