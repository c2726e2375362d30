#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""ranks.py OUT CAPTURE: what several devices give one training. Trains stage 1 once, then some steps of
stage 2 with each number of pictures a step, by one rank and by several (rye train --ranks, one device a
rank), and prints one Markdown table: milliseconds a step (the median of chunks of 20), pictures a second,
how many times those of one rank, and whether the checkpoints have the same bits. With --device-memory
pictures that do not fit into so much stay in the host's memory. Exit status 1 if a training failed. Run
from anywhere; one training at a time."""
import argparse
import hashlib
import json
import pathlib
import subprocess
import sys


def arguments():
    p = argparse.ArgumentParser(description=__doc__)
    here = pathlib.Path(__file__).resolve().parent
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("capture", type=pathlib.Path)
    p.add_argument("--rye", default=str(here / "../build/release/rye"), help="the program")
    p.add_argument("--preset", default="gpu")
    p.add_argument("--config", type=pathlib.Path, help="fields that differ from the preset's")
    p.add_argument("--views", default="1,2,8", help="pictures a step")
    p.add_argument("--ranks", default="1,2")
    p.add_argument("--sums", default="tree,nccl", help="ways to add up several ranks")
    p.add_argument("--pictures", type=int, default=3000, help="pictures of each training")
    p.add_argument("--device-memory", help="the first also by a rank that plans with so many bytes")
    return p.parse_args()


CHUNK = 20  # steps that a device takes before the host looks


def train(o, name, *options):
    """Trains, unless it was done before; returns what --json prints."""
    folder, kept = o.out / name, o.out / f"{name}.json"
    if not kept.exists():
        command = [o.rye, "train", "--capture", o.capture, "--out", folder, "--preset", o.preset,
                   "--device", "cuda", "--overwrite", "--json", "--profile", *options]
        done = subprocess.run([str(c) for c in command], stdout=subprocess.PIPE, text=True)
        if done.returncode != 0:
            sys.exit(f"ranks.py: {name} ended with code {done.returncode}")
        kept.write_text(done.stdout)
    return json.loads(kept.read_text())


def config(o, views):
    """Writes the configuration of steps of so many pictures; returns its path."""
    fields = json.loads(o.config.read_text()) if o.config else {}
    steps = {"views": views, "panel_every": 0, "checkpoint_every": 1000000, "rate_decay": 1}
    fields["gaussians"] = {**fields.get("gaussians", {}), **steps}
    path = o.out / f"views_{views}.config.json"
    path.write_text(json.dumps(fields))
    return path


def measured(o, views, name, *options):
    steps = max(CHUNK, o.pictures // views // CHUNK * CHUNK)
    got = train(o, name, "--begin", o.out / "begun", "--config", config(o, views), "--steps", steps,
                *options)
    part = next(p for p in got["profile"] if p["part"] == "steps on the device")
    bits = hashlib.sha256((o.out / name / "checkpoint.safetensors").read_bytes()).hexdigest()
    return part["median_ms"] / CHUNK, bits


def main():
    o = arguments()
    o.out.mkdir(parents=True, exist_ok=True)
    train(o, "begun", "--config", config(o, 1), "--steps", CHUNK)
    print("| pictures a step | ranks | ms a step | pictures a second | times one rank | bits |")
    print("|---|---|---|---|---|---|")

    def row(views, ranks, ms, one, bits, first):
        same = "" if bits is first else "the same" if bits == first else "other"
        print(f"| {views} | {ranks} | {ms:.2f} | {1e3 * views / ms:.0f} | {one / ms:.3f} | {same} |",
              flush=True)

    for place, views in enumerate(int(v) for v in o.views.split(",")):
        one, first = measured(o, views, f"views_{views}")
        row(views, "1", one, one, first, first)
        if o.device_memory and place == 0:
            ms, bits = measured(o, views, f"views_{views}_held", "--device-memory", o.device_memory)
            row(views, "1, pictures on the host", ms, one, bits, first)
        for ranks in (int(r) for r in o.ranks.split(",")):
            if ranks == 1 or ranks > views:
                continue
            for by in o.sums.split(","):
                ms, bits = measured(o, views, f"views_{views}_{ranks}_{by}", "--ranks", ranks,
                                    "--rank-sum", by)
                row(views, f"{ranks}, {by}", ms, one, bits, first)


main()
