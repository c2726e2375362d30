#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""eyes.py vergence|saccades|estimator RUN [--rye PROGRAM]: what eyes of a trained head do, by the labels that
`rye redirect --labels` writes.
vergence: by how much both axes miss a point that the eyes look at [mm, a world unit taken as 100].
saccades --out FILE.svg: peak velocities and blink durations of `--idle` against the rates they are made by, as a plot.
estimator --capture CAPTURE --pictures N: draws N pictures of random gazes, heads and expressions by all cameras of the
capture, trains a small network on their eyes, and tests it on the test frames' photographs. Reads pictures by ffmpeg;
saccades and estimator need numpy."""
import argparse
import json
import math
import pathlib
import random
import subprocess
import sys
import tempfile
import time

MM = 100  # millimetres of a world unit


def rye(o, *words):
    subprocess.run([o.rye, *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def lines(path):
    with open(path, encoding="utf-8") as file:
        return [json.loads(line) for line in file]


def direction(pitch_yaw):
    p, y = (math.radians(x) for x in pitch_yaw)
    return [math.cos(p) * math.sin(y), math.sin(p), math.cos(p) * math.cos(y)]


def turned(rows, v):
    return [sum(a * b for a, b in zip(row, v)) for row in rows]


def axis_name(o):
    with open(o.run / "config.json", encoding="utf-8") as file:
        return json.load(file).get("gaze_axis", "optical")


def vergence(o):
    axis = axis_name(o)
    print(f"| target [mm ahead, aside, up] | miss of the left, right {axis} axis [mm] |\n|---|---|")
    worst = 0
    with tempfile.TemporaryDirectory() as folder:
        labels, picture = pathlib.Path(folder, "l.jsonl"), pathlib.Path(folder, "p.png")
        for ahead in (300, 600, 2000):
            for aside, up in ((0, 0), (ahead // 6, ahead // 10)):
                at = ",".join(str(x / MM) for x in (aside, up + 30, ahead))
                rye(o, "redirect", "--run", o.run, *o.more, f"--gaze-at=head:{at}", "--labels", labels, "--out", picture)
                row = lines(labels)[0]
                misses = []
                for eye in ("left", "right"):
                    ray = turned(row["head"]["rotation"], direction(row[eye][axis]))
                    to = [a - b for a, b in zip(row["target"], row[eye]["centre"])]
                    along = sum(a * b for a, b in zip(ray, to))
                    misses.append(MM * math.dist(to, [along * x for x in ray]))
                worst = max(worst, *misses)
                print(f"| {ahead}, {aside}, {up} | {misses[0]:.4f}, {misses[1]:.4f} |")
    return 0 if worst < 0.1 else 1


def saccades(o):
    import numpy as np
    fps = 500
    with tempfile.TemporaryDirectory() as folder:
        labels = pathlib.Path(folder, "l.jsonl")
        rye(o, "redirect", "--run", o.run, *o.more, "--idle", o.seconds, "--fps", fps, "--size", "16x16", "--without",
            "drift", "--effects", "still", "--labels", labels, "--out", pathlib.Path(folder, "v.y4m"))
        rows = lines(labels)
    gaze = np.array([direction(r["left"]["optical"]) for r in rows])
    speed = np.degrees(np.linalg.norm(np.diff(gaze, axis=0), axis=1)) * fps
    moving = np.concatenate([[False], speed > 1, [False]])
    starts, ends = (np.flatnonzero(np.diff(moving.astype(int)) == s) for s in (1, -1))
    found = []  # amplitude, peak
    for a, b in zip(starts, ends):
        amplitude = math.degrees(math.acos(min(1, float(gaze[a] @ gaze[b]))))
        if amplitude > 0.5:
            found.append((amplitude, float(speed[a:b].max())))
    names = [i for i, n in enumerate(o.names) if "blink" in n.lower()] if o.names else []
    closed = np.array([max((r["expression"][i] for i in names), default=0) for r in rows])
    shut = np.concatenate([[False], closed > 0.02, [False]])
    blinks = [(b - a) / fps * 1000
              for a, b in zip(*(np.flatnonzero(np.diff(shut.astype(int)) == s) for s in (1, -1)))]
    rate = [p / (434 * (1 - math.exp(-a / 7.8))) for a, p in found]
    print(f"{len(found)} saccades of {min(a for a, _ in found):.1f} to {max(a for a, _ in found):.1f} degrees in "
          f"{o.seconds} s; peak velocity over 434 (1 - exp(-A / 7.8)): median {np.median(rate):.3f}, "
          f"{np.percentile(rate, 5):.3f} to {np.percentile(rate, 95):.3f} (5 to 95 %)")
    print(f"{len(blinks)} blinks" + (f" of {min(blinks):.0f} to {max(blinks):.0f} ms, median {np.median(blinks):.0f} ms"
                                     if blinks else ""))
    plot(o.out, found)
    return 0


def plot(path, found):
    wide, high, most_a, most_v = 480, 300, 22, 450
    at = lambda a, v: (40 + a / most_a * (wide - 50), high - 30 - v / most_v * (high - 45))
    curve = " ".join("%.1f,%.1f" % at(a / 4, 434 * (1 - math.exp(-a / 4 / 7.8))) for a in range(4 * most_a))
    dots = "".join('<circle cx="%.1f" cy="%.1f" r="2"/>' % at(a, v) for a, v in found if a < most_a)
    ticks = "".join('<text x="%.1f" y="%.1f">%d</text>' % (*at(a, -22), a) for a in range(0, most_a, 5))
    ticks += "".join('<text x="2" y="%.1f">%d</text>' % (at(0, v)[1], v) for v in range(0, most_v, 100))
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" font-family="sans-serif" '
                    f'font-size="11"><rect width="100%" height="100%" fill="white"/><polyline points="{curve}" fill="none" '
                    f'stroke="#d62"/><g fill="#246" fill-opacity="0.6">{dots}</g>{ticks}<text x="180" y="{high - 2}">'
                    'amplitude [degrees]</text><text x="44" y="14">peak velocity [degrees a second]</text></svg>\n',
                    encoding="utf-8")


# The estimator: an eye's patch and the head's turn before the camera -> the optical axis before the camera.
WIDE, HIGH, RADII = 36, 24, 2.6  # of a patch [px]; its width in eyeball radii


def patch(np, picture, centre, radius):
    """The patch of an eye [px] from a grey picture, by bilinear samples; None beyond its rim."""
    step = RADII * radius / WIDE
    x = centre[0] - 0.5 + (np.arange(WIDE) - (WIDE - 1) / 2) * step
    y = centre[1] - 0.5 + (np.arange(HIGH) - (HIGH - 1) / 2) * step
    if x[0] < 0 or y[0] < 0 or x[-1] >= picture.shape[1] - 1 or y[-1] >= picture.shape[0] - 1:
        return None
    i, j = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - i, (y - j)[:, None]
    of = lambda dj, di: picture[np.ix_(j + dj, i + di)]
    p = (1 - v) * ((1 - u) * of(0, 0) + u * of(0, 1)) + v * ((1 - u) * of(1, 0) + u * of(1, 1))
    return ((p - p.mean()) / (p.std() + 2)).ravel()


def angles(np, v):
    v = np.asarray(v, float)
    return np.array([math.asin(max(-1, min(1, -v[1]))), math.atan2(v[0], -v[2])])  # towards the camera


def photograph(np, path, size):
    raw = subprocess.run(["ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "gray", "-"], check=True,
                         stdout=subprocess.PIPE).stdout
    return np.frombuffer(raw, np.uint8).reshape(size, size).astype(np.float32)


def test_eyes(np, o, about):
    """Patches, turns and axes of the test frames' eyes that show at least 40 pixels."""
    size, found = about["image_size"][0], []
    for frame in about["test_frames"]:
        gaze = np.load(o.capture / "params" / frame / "gaze.npz")
        pose = np.load(o.capture / "params" / frame / "params.npz")["pose"].ravel()
        for camera in about["camera_ids"]:
            of = np.load(o.capture / "cameras" / frame / f"camera_{camera}.npz")
            K, E = of["intrinsic"], of["extrinsic"]
            picture = next(p for p in (o.capture / "images" / frame).glob(f"image_{camera}.*"))
            grey = photograph(np, picture, size)
            mask = photograph(np, o.capture / "images" / frame / f"eye_mask_{camera}.png", size)
            for eye, (side, code) in enumerate((("left", 85), ("right", 170))):
                if (np.abs(mask - code) < 10).sum() < 40:
                    continue
                c = E[:, :3] @ gaze[f"eye_center_{side}"] + E[:, 3]
                at, radius = (K @ c)[:2] / c[2], K[0, 0] * float(gaze["eye_radius"][eye]) / c[2]
                p = patch(np, grey, at, radius)
                if p is not None:
                    found.append((p, turn(np, E[:, :3] @ rotation(np, pose[:3])), eye,
                                  angles(np, E[:, :3] @ gaze[f"gaze_{side}_world"])))
    return found


def rotation(np, w):
    a = np.linalg.norm(w)
    if a == 0:
        return np.eye(3)
    x, y, z = w / a
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(a) * k + (1 - math.cos(a)) * k @ k


def turn(np, r):
    return np.concatenate([r[:, 2], r[:2, 1]])  # where the face and its top point, before the camera


def drivers(np, o, about, seed, count, path):
    """A table of random gazes, heads, and expressions of the capture's training frames."""
    pick, names = random.Random(seed), about["exp_names"]
    coefficients = [np.load(o.capture / "params" / f / "params.npz")["exp_coeff"].ravel() for f in about["train_frames"]]
    head = ["rotation_x", "rotation_y", "rotation_z"]
    eyes = ["gaze_left_pitch", "gaze_left_yaw", "gaze_right_pitch", "gaze_right_yaw"]
    with open(path, "w", encoding="utf-8") as file:
        print(",".join(names + head + eyes), file=file)
        for _ in range(count):
            pitch, yaw, toe = pick.uniform(-24, 24), pick.uniform(-33, 33), pick.uniform(0, 4)
            row = list(pick.choice(coefficients)) + [pick.uniform(-r, r) for r in (0.18, 0.28, 0.12)]
            row += [pitch, yaw - toe, pitch, yaw + toe]
            print(",".join(f"{x:.5f}" for x in row), file=file)


def y4m(np, stream):
    """The luma of each picture of a video, whose chroma is as large."""
    words = stream.readline().split()
    assert b"C444" in words
    wide, high = (next(int(w[1:]) for w in words if w[:1] == letter) for letter in (b"W", b"H"))
    while stream.readline():
        yield np.frombuffer(stream.read(3 * wide * high), np.uint8)[:wide * high].reshape(high, wide).astype(np.float32)


def drawn_eyes(np, o, about):
    each = -(-o.pictures // len(about["camera_ids"]))
    radius = float(np.load(o.capture / "params" / about["train_frames"][0] / "gaze.npz")["eye_radius"][0])
    found, pictures, seconds = [], 0, 0.0
    with tempfile.TemporaryDirectory() as folder:
        table, labels = pathlib.Path(folder, "d.csv"), pathlib.Path(folder, "l.jsonl")
        for number, camera in enumerate(about["camera_ids"]):
            drivers(np, o, about, number, each, table)
            begin = time.monotonic()
            with subprocess.Popen([o.rye, "redirect", "--run", o.run, "--capture", o.capture, "--camera", camera, "--driving",
                                   table, "--labels", labels, "--out", "-"], stdout=subprocess.PIPE) as process:
                luma = list(y4m(np, process.stdout))
            seconds += time.monotonic() - begin
            rows = lines(labels)
            if process.returncode or len(rows) != len(luma):
                sys.exit(f"eyes.py: got {len(luma)} pictures and {len(rows)} labels of camera {camera}")
            pictures += len(rows)
            for grey, row in zip(luma, rows):
                E, K = np.array(row["camera"]["extrinsic"]), np.array(row["camera"]["intrinsic"])
                before = E[:, :3] @ np.array(row["head"]["rotation"])
                for eye, side in enumerate(("left", "right")):
                    depth = (E[:, :3] @ np.array(row[side]["centre"]) + E[:, 3])[2]
                    p = patch(np, grey, row[side]["pixel"], K[0, 0] * radius / depth)
                    g = np.array(row[side]["optical_in_camera"])
                    if p is not None and g[2] < -0.3 and before[2, 2] < -0.3:  # both towards the camera
                        found.append((p, turn(np, before), eye, angles(np, g)))
    print(f"{pictures} pictures with labels in {seconds:.0f} s: {pictures / seconds:.1f} a second; {len(found)} eyes")
    return found


class Network:
    """Two hidden layers of ReLUs, trained by Adam on squared errors."""

    def __init__(self, np, sizes, seed=1):
        self.np, self.random = np, np.random.default_rng(seed)
        self.w = [self.random.normal(0, math.sqrt(2 / a), (a, b)).astype(np.float32) for a, b in zip(sizes, sizes[1:])]
        self.b = [np.zeros(b, np.float32) for b in sizes[1:]]
        self.moments = [[np.zeros_like(x), np.zeros_like(x)] for x in self.w + self.b]

    def layers(self, x):
        values = [x]
        for k, (w, b) in enumerate(zip(self.w, self.b)):
            y = values[-1] @ w + b
            values.append(self.np.maximum(y, 0) if k + 1 < len(self.w) else y)
        return values

    def train(self, x, y, epochs=40, batch=256):
        np, step = self.np, 0
        for epoch in range(epochs):
            rate = 1e-3 * 0.5 * (1 + math.cos(math.pi * epoch / epochs))
            order = self.random.permutation(len(x))
            for k in range(0, len(x) - batch + 1, batch):
                of, step = order[k:k + batch], step + 1
                values = self.layers(x[of] + self.random.normal(0, 0.1, (batch, x.shape[1])).astype(np.float32))
                g = 2 * (values[-1] - y[of]) / batch
                gradients = [None] * (2 * len(self.w))
                for l in reversed(range(len(self.w))):
                    gradients[l], gradients[len(self.w) + l] = values[l].T @ g, g.sum(0)
                    g = (g @ self.w[l].T) * (values[l] > 0)
                for p, m, d in zip(self.w + self.b, self.moments, gradients):
                    m[0] += 0.1 * (d - m[0])
                    m[1] += 0.001 * (d * d - m[1])
                    p -= rate * (m[0] / (1 - 0.9**step)) / (np.sqrt(m[1] / (1 - 0.999**step)) + 1e-8)


def estimator(o):
    import numpy as np
    with open(o.capture / "capture.json", encoding="utf-8") as file:
        about = json.load(file)
    tests = test_eyes(np, o, about)
    train = drawn_eyes(np, o, about)

    def arrays(eyes):
        x = np.array([np.concatenate([p, 3 * t, [1.0 - 2 * e]]) for p, t, e, _ in eyes], np.float32)
        return x, np.array([a for *_, a in eyes], np.float32)

    def vectors(a):
        return np.stack([np.cos(a[:, 0]) * np.sin(a[:, 1]), np.sin(a[:, 0]), np.cos(a[:, 0]) * np.cos(a[:, 1])], 1)

    def errors(a, b):
        return np.degrees(np.arccos(np.clip((vectors(a) * vectors(b)).sum(1), -1, 1)))

    (x, y), (tx, ty) = arrays(train), arrays(tests)
    scale, middle = y.std(0), y.mean(0)
    network = Network(np, [x.shape[1], 256, 128, 2])
    held = len(x) // 20
    network.train(x[held:], (y[held:] - middle) / scale)
    of = lambda v: network.layers(v)[-1] * scale + middle
    e, own, none = errors(of(tx), ty), errors(of(x[:held]), y[:held]), errors(np.repeat(y.mean(0)[None], len(ty), 0), ty)
    print(f"on {len(ty)} eyes of photographs of test frames: mean {e.mean():.2f}, median {np.median(e):.2f}, 90th percentile "
          f"{np.percentile(e, 90):.2f} degrees; on drawn eyes that it did not train on {own.mean():.2f}; always the mean "
          f"gaze {none.mean():.2f}")
    return 0


def arguments():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("what", choices=("vergence", "saccades", "estimator"))
    p.add_argument("run", type=pathlib.Path)
    p.add_argument("--rye", default=str(pathlib.Path(__file__).resolve().parent / "../build/release/rye"))
    p.add_argument("--capture", type=pathlib.Path)
    p.add_argument("--seconds", type=int, default=60)
    p.add_argument("--pictures", type=int, default=10000)
    p.add_argument("--out", type=pathlib.Path, default=pathlib.Path("saccades.svg"))
    o = p.parse_args()
    o.more = ["--capture", o.capture] if o.capture else []
    o.names = None
    if o.capture:
        with open(o.capture / "capture.json", encoding="utf-8") as file:
            o.names = json.load(file).get("exp_names")
    if o.what == "estimator" and not o.capture:
        p.error("estimator needs --capture")
    return o


if __name__ == "__main__":
    options = arguments()
    sys.exit({"vergence": vergence, "saccades": saccades, "estimator": estimator}[options.what](options))
