#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""imports.py OUT: what avatars of imported captures are worth, with right labels and with those of trackers.
Renders a head, writes it in the layout of each program (make_import_source), without errors and with those
of trackers in the training frames, imports, trains, and measures on frames that training never saw, whose
eyeballs are the true ones. Prints two Markdown tables: labels, and avatars. Results in OUT are
kept: a call that was stopped goes on. Exit status 1 if anything failed; the tables then say so. Run from
anywhere."""
import argparse
import concurrent.futures
import json
import pathlib
import re
import shutil
import subprocess
import sys
import time

from rows import print_table
from trainings import Failed, Slots, add_training_options, call, once

# Kind of make_import_source, kind of `rye import`, further arguments.
SOURCES = {
    "vhap": ("vhap", "vhap"),
    "mono": ("vhap", "vhap"),  # vhap by one camera
    "gha": ("gha", "gha"),  # gaze from the iris
    "gha-file": ("gha", "gha"),  # gaze from a file
    "xgaze": ("xgaze", "xgaze"),
    "gazenerf": ("gazenerf", "xgaze"),
}
SETS = ("clean", "errors")


def arguments():
    p = argparse.ArgumentParser(description=__doc__)
    build = pathlib.Path(__file__).resolve().parent / "../build/release"
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("--rye", default=str(build / "rye"), help="the program")
    p.add_argument("--make", default=str(build / "tests/make_import_source"), help="make_import_source")
    p.add_argument("--sources", default=",".join(SOURCES), help="of " + ", ".join(SOURCES))
    p.add_argument("--sets", default=",".join(SETS), help="of " + ", ".join(SETS))
    p.add_argument("--frames", type=int, default=24, help="training frames, a multiple of 4; a fourth more for tests")
    p.add_argument("--cameras", type=int, default=12)
    p.add_argument("--size", type=int, default=256, help="edge of the pictures [px]")
    p.add_argument("--model", type=pathlib.Path, help="head model of `rye capture`; none: rye's own head")
    p.add_argument("--seed", type=int, default=1, help="of the head, of the errors and of the trainings")
    p.add_argument("--labels-only", action="store_true", help="no trainings: the table of labels alone")
    add_training_options(p)
    return p.parse_args()


def make_truth(o):
    """Writes OUT/truth, and OUT/truth-mono by the most frontal camera alone."""
    log, tests = o.out / "log.txt", o.frames // 4
    model = ["--model", o.model] if o.model else []
    once(o.out / "truth", log, None, o.rye, "capture", "--out", o.out / "truth", "--frames", o.frames,
         "--test-frames", tests - tests // 3, "--apart-frames", tests // 3, "--cameras", o.cameras,
         "--size", o.size, "--seed", o.seed, "--quiet", *model)
    cameras = json.loads((o.out / "truth/capture.json").read_text())["cameras"]
    frontal = min(cameras, key=lambda c: abs(c["yaw_deg"]) + abs(c["pitch_deg"]))["id"]
    once(o.out / "truth-mono", log, None, o.rye, "flaw", "--capture", o.out / "truth", "--out",
         o.out / "truth-mono", "--one-camera", frontal)


def truth_of(o, name):
    return o.out / ("truth-mono" if name == "mono" else "truth")


def write_labels(o, truth, folder, log, env):
    """Compares the labels of the import, and as `rye refine` corrects them, with the truth."""
    refined = folder / "refined"
    once(refined, log, env, o.rye, "refine", "--capture", folder / "capture", "--out", refined)
    lines = {}
    for what in ("capture", "refined"):
        text = subprocess.run([o.make, "compare", truth, folder / what], check=True, capture_output=True,
                              text=True).stdout
        lines[what] = text.splitlines()
    (folder / "labels.json").write_text(json.dumps(lines, indent=1))


def import_source(o, name, errors, folder, log, env):
    kind, importer = SOURCES[name]
    truth, capture = truth_of(o, name), folder / "capture"
    model = ["--model", o.model] if o.model else []
    flaws = ["--errors", o.seed] if errors == "errors" else []
    if not (folder / "made").exists():
        for part in ("source", "tracked", "calibration"):  # of a call that was stopped
            if (folder / part).is_file():
                (folder / part).unlink()
            shutil.rmtree(folder / part, ignore_errors=True)
        call(log, env, o.make, kind, folder, "--capture", truth, *model, *flaws)
        (folder / "made").touch()
    extra = ["--gaze", folder / "gaze.csv"] if name == "gha-file" else []
    extra += ["--calibration", folder / "calibration"] if name == "xgaze" else []
    once(capture / "capture.json", log, env, o.rye, "import", importer, folder / "source", "--out", capture, *extra)
    if not (folder / "labels.json").exists():
        write_labels(o, truth, folder, log, env)
    gazes = ["--gazes"] if name == "gha" else []  # others have those of the source, without errors
    once(folder / "tests", log, env, o.make, "tests", truth, capture, folder / "tests", *gazes)


def train_and_measure(o, slots, name, errors):
    """Writes OUT/NAME-SET with labels.json, run, its results.json and the file seconds, unless complete."""
    folder = o.out / f"{name}-{errors}"
    folder.mkdir(parents=True, exist_ok=True)
    log, run = folder / "log.txt", folder / "run"
    with slots.environment() as env:
        import_source(o, name, errors, folder, log, env)
        if o.labels_only or (run / "results.json").exists():
            return
        extra = ["--config", o.config] if o.config else []
        begin = time.time()
        call(log, env, o.rye, "train", "--capture", folder / "capture", "--out", run, "--preset", o.preset,
             "--seed", o.seed, "--overwrite", *extra)
        (folder / "seconds").write_text(str(time.time() - begin))
        call(log, env, o.rye, "evaluate", "--run", run, "--capture", folder / "tests")


def measure_mono_around(o, errors):
    """Measures the run of one camera from all cameras: the world of VHAP's export is the same."""
    run, around = o.out / f"mono-{errors}/run", o.out / "vhap-clean/tests"
    if (run / "results.json").exists() and around.exists():
        once(run / "around/results.json", o.out / f"mono-{errors}/log.txt", None, o.rye, "evaluate", "--run", run,
             "--capture", around, "--out", run / "around")


def label_cells(folder):
    """Gaze, head and landmarks of the training frames: as imported, then as corrected."""
    try:
        lines = json.loads((folder / "labels.json").read_text())
    except FileNotFoundError:
        return None
    form = re.compile(r"gaze (\S+) deg in the mean, (\S+) at most; head (\S+) deg, (\S+) mm; landmarks (\S+) mm.*?"
                      r"centres (\S+) mm")
    before, after = (form.search(lines[w][0]).groups() for w in ("capture", "refined"))
    test = form.search(lines["capture"][1]).groups()
    return [f"{before[0]}°, {before[1]}°", f"{after[0]}°, {after[1]}°", f"{test[0]}°",
            f"{before[2]}°, {before[3]} mm", f"{after[2]}°, {after[3]} mm", f"{before[4]} mm",
            f"{before[5]}, {after[5]} mm"]


def gaze_of_pairs(o, per_view):
    """Gaze error in frames whose eyes look at one point: what a source with one gaze for both can say."""
    apart = json.loads((o.out / "truth/capture.json").read_text())["independent_gaze_test_frames"]
    views = [v for v in json.loads(per_view.read_text()) if v["frame"] not in apart and v["eyes_visible"]]
    eyes = sum(v["eyes_visible"] for v in views)
    if eyes == 0:
        return "-"
    return f"{sum(v['gaze']['render']['degrees'] * v['eyes_visible'] for v in views) / eyes:.2f}°"


def avatar_cells(o, results, seconds):
    try:
        r = json.loads(results.read_text())["all"]
        took = f"{float(seconds.read_text()):.0f}"
        pairs = gaze_of_pairs(o, results.parent / "per_view.json")
    except FileNotFoundError:
        return None
    render, own = r["gaze"]["render"], r["gaze_without_labels"]["render"]
    found = f"{render['found']} of {r['eyes_visible']}"

    def degrees(table, key):
        return "-" if table[key] is None else f"{table[key]:.2f}°"

    return [f"{r['head']['psnr']:.2f} dB, {r['head']['ssim']:.3f}", f"{r['face']['psnr']:.2f} dB",
            f"{r['eyes']['psnr']:.2f} dB, {r['eyes']['ssim']:.3f}", degrees(render, "degrees"), pairs,
            degrees(render, "degrees_where_found"), found, degrees(own, "degrees"),
            degrees(own, "degrees_where_found"), took]


def main():
    o = arguments()
    names, sets = o.sources.split(","), o.sets.split(",")
    for what, got, known in (("--sources", names, SOURCES), ("--sets", sets, SETS)):
        for one in got:
            if one not in known:
                sys.exit(f"imports.py: {what} got '{one}', expected some of {', '.join(known)}")
    if o.frames < 8 or o.frames % 4:
        sys.exit(f"imports.py: --frames got {o.frames}, expected a multiple of 4 from 8 on")
    o.out.mkdir(parents=True, exist_ok=True)
    try:
        make_truth(o)
    except Failed as e:
        sys.exit(f"imports.py: {e}")
    slots = Slots(o.jobs, o.devices)
    tasks = [(n, s) for s in sets for n in names]
    with concurrent.futures.ThreadPoolExecutor(o.jobs) as pool:
        for task, done in [(t, pool.submit(train_and_measure, o, slots, *t)) for t in tasks]:
            try:
                done.result()
            except (Failed, subprocess.CalledProcessError) as e:
                print(f"imports.py: {task[0]}, {task[1]}: {e}", file=sys.stderr)
    missing = print_table(
        ["source", "labels", "gaze of training frames, mean and largest error", "corrected", "gaze of test frames",
         "head poses", "corrected", "landmarks", "eyeball centres, then corrected"],
        [(f"`{n}`", s, label_cells(o.out / f"{n}-{s}")) for n, s in tasks])
    if o.labels_only:
        sys.exit(1 if missing else 0)
    rows = []
    for name, errors in tasks:
        folder = o.out / f"{name}-{errors}"
        rows.append((f"`{name}`", errors, avatar_cells(o, folder / "run/results.json", folder / "seconds")))
        if name == "mono" and "vhap" in names and "clean" in sets:
            try:
                measure_mono_around(o, errors)
            except Failed as e:
                print(f"imports.py: mono, {errors}: {e}", file=sys.stderr)
            rows.append(("`mono`, all cameras", errors,
                         avatar_cells(o, folder / "run/around/results.json", folder / "seconds")))
    missing += print_table(
        ["source", "labels", "head: PSNR, SSIM", "face", "eyes: PSNR, SSIM", "gaze error",
         "... of eyes that look at one point", "... where found", "irises found", "without labels",
         "... where found", "seconds"], rows)
    sys.exit(1 if missing else 0)


main()
