#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""videos.py OUT --head NAME=MODEL:SEED ...: what avatars of videos are worth. Films heads that look at the dots
of docs/gaze_dots.html and then around while they turn, and heads that turn further and see no dots; tracks and
imports the videos, the first ones with and without the dots, trains, and measures by the truth, which nothing else
has seen: at times of the video that training did not see, and from cameras at 30 and 45 degrees to both sides; and
by benchmarks/judge where its models are. Prints two Markdown tables: labels, and avatars. Results in
OUT are kept: a call that was stopped goes on, on another machine, too, where --train says that only trainings
are left. Exit status 1 if anything failed; the tables then say so. Run from anywhere."""
import argparse
import concurrent.futures
import json
import os
import pathlib
import queue
import re
import subprocess
import sys
import time

from rows import print_table

WAYS = ("plain", "dots", "free")  # a film of dots, read without and with them; a film without dots


def arguments():
    p = argparse.ArgumentParser(description=__doc__)
    here = pathlib.Path(__file__).resolve().parent
    build = here / "../build/release"
    p.add_argument("out", type=pathlib.Path)
    p.add_argument("--head", action="append", required=True, metavar="NAME=MODEL:SEED",
                   help="a head to film: a model of `rye capture`, and a seed")
    p.add_argument("--rye", default=str(build / "rye"), help="the program")
    p.add_argument("--tests", type=pathlib.Path, default=build / "tests", help="has video_truth and video_views")
    p.add_argument("--frames", type=int, default=300, help="pictures of each video")
    p.add_argument("--rate", type=int, default=5, help="pictures a second")
    p.add_argument("--size", type=int, default=1080, help="edge of the video [px]")
    p.add_argument("--ways", default=",".join(WAYS), help="of plain, dots, free")
    p.add_argument("--preset", default="cpu")
    p.add_argument("--picture", type=int, default=512, help="most pixels of a side of the captures")
    p.add_argument("--labels-only", action="store_true", help="no trainings")
    p.add_argument("--train", action="store_true", help="only trainings: labels and captures are in OUT")
    p.add_argument("--jobs", type=int, default=1, help="trainings at once")
    p.add_argument("--devices", type=int, default=0, help="CUDA devices to spread the trainings over")
    o = p.parse_args()
    o.page, o.dots_page = here / "../docs/gaze_dots.html", here / "../tests/importers/dots_of_page.js"
    o.heads = {}
    for text in o.head:
        form = re.fullmatch(r"(\w+)=(.+):(\d+)", text)
        if not form:
            sys.exit(f"videos.py: --head got '{text}', expected NAME=MODEL:SEED")
        o.heads[form[1]] = (form[2], form[3])
    o.ways = o.ways.split(",")
    for way in o.ways:
        if way not in WAYS:
            sys.exit(f"videos.py: --ways got '{way}', expected some of {', '.join(WAYS)}")
    return o


class Failed(Exception):
    pass


def call(folder, step, env, *command):
    """Calls a command whose output STEP.txt gets; its seconds and memory go to STEP.json."""
    begin = time.time()
    with open(folder / f"{step}.txt", "w") as out:
        child = subprocess.Popen([str(c) for c in command], stdout=out, stderr=out, env=env)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        raise Failed(f"{' '.join(str(c) for c in command[:3])} failed; see {folder / step}.txt")
    took = {"seconds": time.time() - begin, "gigabytes": usage.ru_maxrss / 1e6}
    (folder / f"{step}.json").write_text(json.dumps(took))


def once(path, folder, step, env, *command):
    """Calls a command that makes `path`, unless it is there."""
    if not path.exists():
        call(folder, step, env, *command)


def film(o, name, way):
    """Films a head, unless it was; returns the folder of head.mp4, truth and tracks, and the dots' file or None."""
    folder = o.out / name / "free" if way == "free" else o.out / name
    folder.mkdir(parents=True, exist_ok=True)
    model, seed = o.heads[name]
    dots = None if way == "free" else folder / "dots.csv"
    if dots and not dots.exists():
        dots.write_text(subprocess.run(["node", o.dots_page, o.page, "40", "1.2"], check=True, capture_output=True,
                                       text=True).stdout)
    acts = ["--turn", "25", "--dots", dots, "--dots-begin", "2.3"] if dots else []
    once(folder / "truth", folder, "film", None, o.rye, "capture", "--model", model, "--seed", seed, "--video",
         folder / "head.mp4", "--out", folder / "truth", "--frames", o.frames, "--rate", o.rate, "--size", o.size,
         "--quiet", *acts)
    return folder, dots


def film_and_import(o, name):
    """Writes OUT/NAME: films, and for each way capture, refined, true, views, and their texts."""
    model = o.heads[name][0]
    for way in o.ways:
        folder, dots = film(o, name, way)
        truth, tracks = folder / "truth", folder / "tracks"
        at = o.out / name / way
        at.mkdir(exist_ok=True)
        if not (tracks / "0/tracks.jsonl").exists():
            call(at, "track", None, o.rye, "import", "video", folder / "head.mp4", "--every", "1", "--size", o.picture,
                 "--out", at / "tracked")
            (at / "tracked.tracks").rename(tracks)
        extra = ["--dots", dots] if way == "dots" else []
        once(at / "capture/capture.json", at, "import", None, o.rye, "import", "video", tracks / "0", "--size",
             o.picture, "--out", at / "capture", *extra)
        once(at / "refined", at, "refine", None, o.rye, "refine", "--capture", at / "capture", "--out", at / "refined")
        once(at / "true", at, "labels", None, o.tests / "video_truth", truth, at / "capture", at / "true")
        once(at / "refined.txt", at, "refined", None, o.tests / "video_truth", truth, at / "refined")
        once(at / "views/capture.json", at, "views", None, o.tests / "video_views", truth, model, at / "capture",
             at / "views")


def train_and_measure(o, free, name, way):
    at = o.out / name / way
    run = at / f"run-{o.preset}"
    device = free.get()
    env = dict(os.environ) if o.devices == 0 else dict(os.environ, CUDA_VISIBLE_DEVICES=str(device % o.devices))
    try:
        once(at / f"train-{o.preset}.json", at, f"train-{o.preset}", env, o.rye, "train", "--capture", at / "capture", "--out",
             run, "--preset", o.preset, "--overwrite")
        once(run / "results.json", at, f"measure-{o.preset}", env, o.rye, "evaluate", "--run", run, "--capture",
             at / "true")
        once(run / "views/results.json", at, f"measure-views-{o.preset}", env, o.rye, "evaluate", "--run", run,
             "--capture", at / "views", "--out", run / "views")
    finally:
        free.put(device)


def judge(o, tasks):
    """Has benchmarks/judge look at the evaluations that it has not seen; says why where it cannot."""
    runs = [o.out / n / w / f"run-{o.preset}" for n, w in tasks]
    new = [r for r in runs if (r / "results.json").exists() and not (r / "judge.json").exists()]
    if new:
        subprocess.run(["sh", pathlib.Path(__file__).parent / "judge/judge.sh", *new], check=False)


def judge_cell(run):
    """The judge's gaze error and that of eyes at rest, and the number of eyes."""
    try:
        gaze = json.loads((run / "judge.json").read_text())["all"]["gaze"]
    except FileNotFoundError:
        return "not run"
    return f"{gaze['degrees']:.1f}°; {gaze['at_rest']:.1f}°, {gaze['eyes']}" if gaze["eyes"] else "no eye taken"


def label_cells(at):
    try:
        text, refined = (at / "labels.txt").read_text(), (at / "refined.txt").read_text()
    except FileNotFoundError:
        return None

    def found(form):
        return re.search(form, text)[1]

    def gazes(where):
        form = r"gaze, \w+ +(\S+) deg in the mean, (\S+) in"
        return ", ".join(f"{mean}° ({middle}°)" for mean, middle in re.findall(form, where))

    return [found(r"frames +(\d+)"), found(r"focal length +(\S+ %)"), found(r"distance +(\S+ %)"),
            found(r"head pose +(\S+) deg") + "°, " + found(r"eyes (\S+) mm") + " mm", gazes(text), gazes(refined),
            found(r"masks +(\S+) int") + ", " + found(r"heads, (\S+) of eyes")]


def of_cameras(path, cameras):
    """Mean PSNR of the head and gaze error over the visible eyes of these cameras' views."""
    views = [v for v in json.loads(path.read_text()) if v["camera"] in cameras]
    psnr = sum(v["head"]["psnr"] for v in views) / len(views)
    eyes = [(v["gaze"]["render"]["degrees"], v["eyes_visible"]) for v in views if v["eyes_visible"]]
    count = sum(n for _, n in eyes)
    return f"{psnr:.2f} dB, " + (f"{sum(d * n for d, n in eyes) / count:.1f}°" if count else "no eye seen")


def avatar_cells(o, at):
    run = at / f"run-{o.preset}"
    try:
        r = json.loads((run / "results.json").read_text())["all"]
        views = [of_cameras(run / "views/per_view.json", c) for c in (("00",), ("02", "03"), ("01", "04"))]
        took = json.loads((at / f"train-{o.preset}.json").read_text())
    except FileNotFoundError:
        return None
    return [f"{r['head']['psnr']:.2f} dB, {r['head']['ssim']:.3f}", f"{r['face']['psnr']:.2f} dB",
            f"{r['eyes']['psnr']:.2f} dB", judge_cell(run), *views,
            f"{took['seconds']:.0f}", f"{took['gigabytes']:.1f}"]


def main():
    o = arguments()
    o.out.mkdir(parents=True, exist_ok=True)
    for name in o.heads if not o.train else []:
        try:
            film_and_import(o, name)
        except (Failed, subprocess.CalledProcessError) as e:
            print(f"videos.py: {name}: {e}", file=sys.stderr)
    tasks = [(n, w) for n in o.heads for w in o.ways]
    free = queue.Queue()
    for i in range(o.jobs):
        free.put(i)
    with concurrent.futures.ThreadPoolExecutor(o.jobs) as pool:
        for task, done in [(t, pool.submit(train_and_measure, o, free, *t)) for t in tasks if not o.labels_only]:
            try:
                done.result()
            except Failed as e:
                print(f"videos.py: {task[0]}, {task[1]}: {e}", file=sys.stderr)
    if not o.labels_only:
        judge(o, tasks)
    missing = print_table(
        ["head", "gazes", "frames", "focal length", "distance", "head poses",
         "gaze of left and right eye, mean (median)", "corrected",
         "masks of head and eyes"], [(n, w, label_cells(o.out / n / w)) for n, w in tasks])
    if not o.labels_only:
        missing += print_table(
            ["head", "gazes", "head: PSNR, SSIM", "face", "eyes", "judge: gaze; at rest, eyes",
             "from the video's camera: head, gaze error",
             "30° aside", "45° aside", "seconds", "GB"],
            [(n, w, avatar_cells(o, o.out / n / w)) for n, w in tasks])
    sys.exit(1 if missing else 0)


main()
