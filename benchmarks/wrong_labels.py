#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""wrong_labels.py OUT CAPTURE...: what errors of labels, cameras and pictures cost. Copies each capture
with the errors that docs/flaws.md lists (rye flaw), trains on each copy, measures against the capture
itself, and prints one Markdown table: means over seeds, with sample standard deviations if there are
several. A seed is that of the errors and of the training. "By the run" measures what no picture decides
otherwise: test frames have the head frame of the run (--align-head) and, as frames of a rig whose cameras
were measured wrongly, the same wrong cameras, which the run has corrected. A set with "+refined" is
trained on the labels that the run of the set without it refines (rye refine RUN), with "+poses" on its
head poses alone. Results in OUT are kept: a call that was stopped goes on. After
`sh benchmarks/judge/judge.sh OUT` the same call prints the judge's columns, too. Exit status 1 if a training failed; the table then says so. Run from anywhere."""
import argparse
import concurrent.futures
import json
import pathlib
import sys
import time

from judged import TITLES, cells, judged
from trainings import EXPRESSION, LANDMARKS, POSE, TRACK, Failed, Slots, add_training_options, call, shown

GAZE = ["--gaze-common", "4", "--gaze-single", "2"]
GAINS = ["--gain", "12", "--white-balance", "5"]
CAMERAS = ["--camera-rotation", "0.5", "--focal", "1"]
SETS = {
    "clean": None,
    "gaze": GAZE + ["--centres", "1.2"],
    "track": TRACK + ["--centres", "1"],
    "gains": GAINS,
    "cameras": CAMERAS,
    "all": GAZE + TRACK + ["--centres", "1.2"] + GAINS + CAMERAS,
    # Parts of track, measured where --sets names them.
    "expression": EXPRESSION,
    "pose": POSE,
    "landmarks": LANDMARKS,
}
REFINE = ["--size", "128", "--steps", "5"]
REFINED = {"refined": REFINE, "poses": REFINE + ["--no-gaze"]}
USUAL = ("clean", "gaze", "track", "gains", "cameras", "all")


def arguments():
    p = argparse.ArgumentParser(description=__doc__)
    here = pathlib.Path(__file__).resolve().parent
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("captures", nargs="+", type=pathlib.Path)
    p.add_argument("--rye", default=str(here / "../build/release/rye"), help="the program")
    p.add_argument("--sets", default=",".join(USUAL),
                   help="of " + ", ".join(SETS) + "; with +" + " or +".join(REFINED) + " trained again")
    p.add_argument("--seeds", default="1,2,3")
    add_training_options(p)
    return p.parse_args()


def train_and_measure(o, slots, capture, set_name, seed, first):
    """Writes OUT/CAPTURE/SET_SEED with run, evaluation and the file seconds, unless it is complete.
    `first`: the task whose run refines the labels, or None."""
    if first:
        first.result()
    name, _, refined = set_name.partition("+")
    folder = o.out / capture.name / f"{set_name}_{seed}"
    if (folder / "run/results.json").exists():
        return
    folder.mkdir(parents=True, exist_ok=True)
    log, copy, run = folder / "log.txt", folder / "capture", folder / "run"
    with slots.environment() as env:
        if refined and not copy.exists():
            of = o.out / capture.name / f"{name}_{seed}"
            call(log, env, o.rye, "refine", of / "run", "--capture", of / "capture" if SETS[name] else capture,
                 "--out", copy, *REFINED[refined])
        elif SETS[name] and not copy.exists():
            call(log, env, o.rye, "flaw", "--capture", capture, "--out", copy, "--seed", seed, *SETS[name])
        begin = time.time()
        extra = ["--config", o.config] if o.config else []
        call(log, env, o.rye, "train", "--capture", copy if copy.exists() else capture, "--out", run,
             "--preset", o.preset, "--seed", seed, "--overwrite", *extra)
        (folder / "seconds").write_text(str(time.time() - begin))
        # the cameras of `gains` draw the test frames, too
        measured = by_run = copy if name == "gains" else capture
        if name in ("cameras", "all"):
            by_run = folder / "cameras"
            if not by_run.exists():
                call(log, env, o.rye, "flaw", "--capture", capture, "--out", by_run, "--seed", seed,
                     "--labels", "all", *CAMERAS)
        evaluate = [o.rye, "evaluate", "--run", run, "--capture"]
        call(log, env, *evaluate, by_run, "--align-head", "--out", folder / "by_run")
        call(log, env, *evaluate, measured)


def figures(folder):
    try:
        results = json.loads((folder / "run/results.json").read_text())
        by_run = json.loads((folder / "by_run/results.json").read_text())["all"]
        seconds = float((folder / "seconds").read_text())
    except FileNotFoundError:
        return None
    r, lids = results["all"], (results.get("closed_lids") or {}).get("visible")
    seen, render = r["eyes_visible"], r["gaze"]["render"]
    return {"head": r["head"]["psnr"], "by_run": by_run["head"]["psnr"],
            "gaze_by_run": by_run["gaze"]["render"]["degrees"], "ssim": r["head"]["ssim"],
            "face": r["face"]["psnr"], "eyes": r["eyes"]["psnr"], "gaze": render["degrees"],
            "where_found": render["degrees_where_found"], "found": 100 * render["found"] / max(seen, 1),
            "without": r["gaze_without_labels"]["render"]["degrees"], "lids": None if lids is None else 100 * lids,
            "seconds": seconds, "judged": judged(folder / "run")}


def table(o, captures, sets, seeds):
    columns = [("head", 2, " dB"), ("ssim", 3, ""), ("face", 2, " dB"), ("eyes", 2, " dB"), ("gaze", 2, "°"),
               ("where_found", 2, "°"), ("found", 0, " %"), ("without", 2, "°"),
               ("by_run", 2, " dB"), ("gaze_by_run", 2, "°"), ("lids", 0, " %"), ("seconds", 0, "")]
    print("| capture | errors | seeds | head: PSNR | SSIM | face | eyes | gaze error | ... where found "
          f"| irises found | without labels | head, by the run | gaze error, by the run | closed lids show | seconds | {' | '.join(TITLES)} |")
    print("|" + "---|" * (15 + len(TITLES)))
    missing = 0
    for capture in captures:
        for name in sets:
            every = [figures(o.out / capture.name / f"{name}_{s}") for s in seeds]
            rows = [r for r in every if r]
            missing += len(every) - len(rows)
            if not rows:
                print(f"| {capture.name} | {name} | 0 of {len(seeds)} |" + " failed |" * (12 + len(TITLES)))
                continue
            line = [shown([r[c] for r in rows], digits, unit) for c, digits, unit in columns]
            line += cells([r["judged"] for r in rows], shown)
            print(f"| {capture.name} | {name} | {len(rows)} of {len(seeds)} | " + " | ".join(line) + " |")
    return missing


def main():
    o = arguments()
    sets, seeds = o.sets.split(","), [int(s) for s in o.seeds.split(",")]
    for name in sets:
        base, plus, refined = name.partition("+")
        if base not in SETS or plus and refined not in REFINED:
            sys.exit(f"wrong_labels.py: --sets got '{name}', expected some of {', '.join(SETS)}, "
                     f"with nothing after it, +{' or +'.join(REFINED)}")
        # Refined captures have the run's cameras, which its record of corrections does not name.
        if plus and (base not in sets or base in ("cameras", "all")):
            sys.exit(f"wrong_labels.py: --sets got '{name}', expected '{base}' beside it, and none with "
                     "wrong cameras")
    if len({c.name for c in o.captures}) != len(o.captures):
        sys.exit("wrong_labels.py: two captures have the same folder name")
    slots = Slots(o.jobs, o.devices)
    tasks = [(c, n, s) for s in seeds for c in o.captures for n in sets]
    tasks.sort(key=lambda t: "+" in t[1])  # none waits for one behind it
    with concurrent.futures.ThreadPoolExecutor(o.jobs) as pool:
        done = {}
        for c, n, s in tasks:
            first = done[c, n.partition("+")[0], s] if "+" in n else None
            done[c, n, s] = pool.submit(train_and_measure, o, slots, c, n, s, first)
        for task in tasks:
            try:
                done[task].result()
            except Failed as e:
                print(f"wrong_labels.py: {task[0].name}, {task[1]}, seed {task[2]}: {e}", file=sys.stderr)
    sys.exit(1 if table(o, o.captures, sets, seeds) else 0)


main()
