#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""one_camera.py OUT MODEL:SEED...: what an avatar is worth whose training saw one camera. Renders each head
(`rye capture`) from the front, in as many pictures as --pictures says, trains on them with exact labels and
with those of a tracker, and measures on test frames from twelve cameras around it. Prints a Markdown table:
means over seeds, of errors and training, with sample standard deviations; the last columns are the head and
the face [dB] by how far a view is from the camera that was filmed. Results in OUT are kept: a call that was
stopped goes on. Exit status 1 if a training failed; the table then says so. Run from anywhere."""
import argparse
import concurrent.futures
import json
import math
import pathlib
import statistics
import sys

from trainings import TRACK, Failed, Slots, add_training_options, call, once, shown

LABELS = {"exact": None, "tracked": TRACK + ["--centres", "1"]}
AWAY = ((0, 5), (5, 25), (25, 50), (50, 90))  # degrees between directions of view


def arguments():
    p = argparse.ArgumentParser(description=__doc__)
    build = pathlib.Path(__file__).resolve().parent / "../build/release"
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("heads", nargs="+", help="head model of `rye capture` and seed of the head")
    p.add_argument("--rye", default=str(build / "rye"), help="the program")
    p.add_argument("--pictures", default="12,24,300")
    p.add_argument("--labels", default=",".join(LABELS), help="of " + ", ".join(LABELS))
    p.add_argument("--seeds", default="1,2,3")
    add_training_options(p)
    return p.parse_args()


def head_name(head):
    model, _, seed = head.rpartition(":")
    return f"{pathlib.Path(model).stem}-{seed}"


def make_captures(o, head):
    """Writes OUT/HEAD/around, to measure on, and OUT/HEAD/N of one camera for each number of pictures."""
    model, _, seed = head.rpartition(":")
    folder = o.out / head_name(head)
    folder.mkdir(parents=True, exist_ok=True)
    for name, frames, cameras in [("around", 24, 12)] + [(n, n, 1) for n in o.pictures.split(",")]:
        once(folder / name, folder / "log.txt", None, o.rye, "capture", "--model", model, "--seed", seed,
             "--frames", frames, "--cameras", cameras, "--quiet", "--out", folder / name)


def train_and_measure(o, slots, folder, pictures, labels, seed):
    """Writes FOLDER/PICTURES-LABELS_SEED with run and its results, unless it is complete."""
    of = folder / f"{pictures}-{labels}_{seed}"
    run, copy, log = of / "run", of / "capture", of / "log.txt"
    if (run / "results.json").exists():
        return
    of.mkdir(parents=True, exist_ok=True)
    with slots.environment() as env:
        if LABELS[labels]:
            once(copy, log, env, o.rye, "flaw", "--capture", folder / pictures, "--out", copy, "--seed", seed,
                 *LABELS[labels])
        call(log, env, o.rye, "train", "--capture", copy if copy.exists() else folder / pictures, "--out", run,
             "--preset", o.preset, "--seed", seed, "--overwrite", *(["--config", o.config] if o.config else []))
        call(log, env, o.rye, "evaluate", "--run", run, "--capture", folder / "around")


def camera_angles(capture):
    """Degrees of each camera from the front, in which the filmed one is."""
    cameras = json.loads((capture / "capture.json").read_text())["cameras"]
    cosines = {c["id"]: math.prod(math.cos(math.radians(c[k])) for k in ("yaw_deg", "pitch_deg")) for c in cameras}
    return {camera: math.degrees(math.acos(cosine)) for camera, cosine in cosines.items()}


def figures(folder, name):
    try:
        r = json.loads((folder / name / "run/results.json").read_text())["all"]
        views = json.loads((folder / name / "run/per_view.json").read_text())
    except FileNotFoundError:
        return None
    away = camera_angles(folder / "around")
    row = {"head": r["head"]["psnr"], "ssim": r["head"]["ssim"], "face": r["face"]["psnr"],
           "eyes": r["eyes"]["psnr"], "gaze": r["gaze"]["render"]["degrees"],
           "without": r["gaze_without_labels"]["render"]["degrees"]}
    for least, most in AWAY:
        near = [v for v in views if least <= away[v["camera"]] < most]
        for part in ("head", "face"):
            seen = [v[part]["psnr"] for v in near if v[part]]
            row[part, most] = statistics.mean(seen) if seen else None
    return row


def table(o, heads):
    columns = [("head", 2, " dB"), ("ssim", 3, ""), ("face", 2, " dB"), ("eyes", 2, " dB"), ("gaze", 2, "°"),
               ("without", 2, "°")]
    seeds = o.seeds.split(",")
    print("| head | pictures, labels | seeds | head: PSNR | SSIM | face | eyes | gaze error | without labels | "
          + " | ".join(f"{least}° to {most}°: head, face" for least, most in AWAY) + " |")
    print("|" + "---|" * (9 + len(AWAY)))
    missing = 0
    for head in heads:
        for pictures in o.pictures.split(","):
            for labels in o.labels.split(","):
                every = [figures(o.out / head, f"{pictures}-{labels}_{s}") for s in seeds]
                rows = [r for r in every if r]
                missing += len(every) - len(rows)
                print(f"| {head} | {pictures}, {labels} | {len(rows)} of {len(seeds)} | ", end="")
                if not rows:
                    print(" | ".join(["failed"] * (6 + len(AWAY))) + " |")
                    continue
                line = [shown([r[c] for r in rows], digits, unit) for c, digits, unit in columns]
                for _, most in AWAY:
                    pair = [[r[part, most] for r in rows] for part in ("head", "face")]
                    line.append(", ".join("none" if None in p else f"{statistics.mean(p):.1f}" for p in pair))
                print(" | ".join(line) + " |")
    return missing


def main():
    o = arguments()
    for labels in o.labels.split(","):
        if labels not in LABELS:
            sys.exit(f"one_camera.py: --labels got '{labels}', expected some of {', '.join(LABELS)}")
    for head in o.heads:
        model, _, seed = head.rpartition(":")
        if not seed.isdigit() or not pathlib.Path(model).is_file():
            sys.exit(f"one_camera.py: got '{head}', expected MODEL:SEED, the file of a head model and a whole number")
    try:
        for head in o.heads:
            make_captures(o, head)
    except Failed as e:
        sys.exit(f"one_camera.py: {e}")
    slots, heads = Slots(o.jobs, o.devices), [head_name(h) for h in o.heads]
    # the longest first
    numbers = sorted(o.pictures.split(","), key=int, reverse=True)
    tasks = [(h, n, w, s) for n in numbers for s in o.seeds.split(",") for h in heads for w in o.labels.split(",")]
    with concurrent.futures.ThreadPoolExecutor(o.jobs) as pool:
        for task, done in [(t, pool.submit(train_and_measure, o, slots, o.out / t[0], *t[1:])) for t in tasks]:
            try:
                done.result()
            except Failed as e:
                print(f"one_camera.py: {', '.join(task)}: {e}", file=sys.stderr)
    sys.exit(1 if table(o, heads) else 0)


main()
