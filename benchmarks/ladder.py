# SPDX-License-Identifier: Apache-2.0
"""ladder.py, the part of ladder.sh that reads and writes JSON.

ladder.py lists OUT RYE RUNG...: writes OUT/ladder_paper-literal.json and OUT/ladder_gpu.json, lists
for `rye compare` of the rungs that begin with either preset; only those with a rung.
ladder.py table OUT SPLIT GROUP: prints what the runs of the lists have measured, as Markdown.
"""
import json
import os
import re
import struct
import subprocess
import sys

from judged import TITLES, cells, judged

# Fields of rungs, as those of `gpu` where they are no readings of `paper`.
NETWORKS = {
    "geometry": 4 * [128], "exp_color": 2 * [128], "pose_color": [64], "exp_deform": 4 * [128],
    "pose_deform": 2 * [128], "exp_attributes": 2 * [128], "pose_attributes": [64],
    "gaze_deform": 3 * [128], "gaze_color": [128], "eye_offset": 2 * [64],
}
RATES = {
    "upsampler": 1e-3, "networks": 1e-3, "deform": 3e-5, "opacity": 1e-2, "scale": 5e-3,
    "position": 1e-3, "feature": 5e-3, "rotation": 2e-3, "eye_feature": 1e-2, "shading": 1e-2,
}
PARTS = {
    "L0": {},
    "L1a64": {"gaussians": {"steps": 64000}},
    "L1a288": {"gaussians": {"steps": 288000}},
    "L1pictures": {"gaussians": {"epochs_over": "pictures"}},
    "L1b": {"gaussians": {"rates": RATES, "rate_decay": 0.05}},
    "L2a": {"gaussians": {"upsampler": {"doublings": 1}}},
    "L2": {"gaussians": {"upsampler": {"doublings": 0}}},
    "L2auto": {"gaussians": {"upsampler": {"doublings": "auto"}}},
    "L3a": {"gaussians": {"upsampler": {"norm": "none"}}},
    "L3": {"gaussians": {"upsampler": {"norm": "none", "skip": True}}},
    "L3c": {"gaussians": {"weights": {"eye_high": 0}}},
    "L4": {"mesh": {"weights": {"laplacian_unit": "metre"}}},
    "L5a": {"mesh": {"steps": 16000}},
    "L5b": {"mesh": {"landmarks_follow_gaze": True}},
    "L5c": {"mesh": {"landmarks_follow_gaze": True, "fit_steps": 10000, "fit_rate": 3e-3}},
    "L5d": {"mesh": {"landmarks_follow_gaze": True, "fit_steps": 10000, "fit_rate": 3e-3,
                     "fit_mixed": 0.85, "fit_lids": 10, "fit_regions": True,
                     "fit_shapes": True}},
    "L5": {"mesh": {"steps": 16000, "landmarks_follow_gaze": True, "fit_steps": 10000,
                    "fit_rate": 3e-3, "fit_mixed": 0.85, "fit_lids": 10,
                    "fit_regions": True, "fit_shapes": True}},
    "L6": {"avatar": {"pose_frequencies": 1, "gaze_frequencies": 1, "drivers_from_zero": True}},
    "L7a": {"avatar": {"eye_appearance": "driven"}},
    "L7b": {"gaussians": {"eyeball": {"bulge": True}}},
    "L7c": {"gaussians": {"eyeball": {"thickness": 0.1}}},
    "L7d": {"gaussians": {"eyeball": {"max_growth": 0.7}}},
    "L7e": {"gaussians": {"weights": {"eye_smooth": 0.1}}},
    "L7f": {"gaussians": {"eyeball": {"points": 4000}}},
    "L7g": {"gaussians": {"rates": {"eye_offset": 0}}},
    "L8": {"gaussians": {"weights": {"face_alone": 1}}},
    "L9": {"gaussians": {"spacing": 0.01, "spacing_slope": 0.02, "mouth_points": 2000}},
    "L10": {"gaussians": {"weights": {"dssim": 0.5}}},
    "L11a": {"avatar": {"shading": "head_pose"}},
    "L11b": {"gaussians": {"augment": False}},
    "L11c": {"mesh": {"views": 2, "rate_decay": 0.1}},
    "L11d": {"grid": {"cell": 3.5 / 32}},
    "L11e": {"avatar": {"feature": 64, "channels": 16, "networks": NETWORKS},
             "gaussians": {"upsampler": {"capacity": 16}}},
    "L11f": {"correct_labels": True, "correct_colours": True, "correct_cameras": True},
    "L11g": {"gaussians": {"lid_steps": 2000}},
}


def merged(*configs):
    out = {}
    for config in configs:
        for key, value in config.items():
            inner = isinstance(value, dict) and isinstance(out.get(key), dict)
            out[key] = merged(out[key], value) if inner else value
    return out


PARTS["L7"] = merged(*(PARTS["L7" + x] for x in "cdefg"))
PARTS["L11"] = merged(*(PARTS["L11" + x] for x in "abcdefg"))
LADDER = ["L1b", "L2", "L3", "L4", "L5", "L6", "L7", "L8", "L9", "L10", "L11"]
FACTORS = ["L1b", "L2", "L3", "L5"]
SETS = {
    "alone": ["L0"] + LADDER,
    "factorial": ["L0"] + ["+".join(f for i, f in enumerate(FACTORS) if bits >> i & 1)
                           for bits in range(1, 1 << len(FACTORS))],
    "cumulative": ["L0"] + ["to-" + rung for rung in LADDER],
    "removed": ["gpu"] + ["gpu-" + rung for rung in LADDER],
    "fine": ["L0"] + [rung for rung in PARTS if rung not in LADDER + ["L0"]],
}


def fields_of(fields, values):
    """Returns the values of the fields that a configuration names."""
    return {k: fields_of(v, values[k]) if isinstance(v, dict) else values[k]
            for k, v in fields.items()}


def part(name):
    if name not in PARTS:
        sys.exit(f"ladder.sh: got the rung '{name}', expected {', '.join(PARTS)}; to-RUNG, "
                 f"gpu-RUNG, gpu+RUNG, RUNG+RUNG, paper, gpu; or {', '.join(SETS)}")
    return PARTS[name]


def config_of(rung, literal):
    """Returns the preset and the fields of a rung."""
    if rung in ("gpu", "paper"):
        return "gpu" if rung == "gpu" else "paper-literal", {} if rung == "gpu" else merged(
            PARTS["L1pictures"], PARTS["L2auto"], PARTS["L4"], PARTS["L7a"], PARTS["L7b"])
    if rung.startswith("gpu-"):
        return "gpu", merged(*(fields_of(part(r), literal) for r in rung[4:].split("+")))
    if rung.startswith("gpu+"):
        return "gpu", merged(*(part(r) for r in rung[4:].split("+")))
    if rung.startswith("to-"):
        if rung[3:] not in LADDER:
            sys.exit(f"ladder.sh: got '{rung}', expected to- and one of {', '.join(LADDER)}")
        return "paper-literal", merged(
            *(part(r) for r in LADDER[:LADDER.index(rung[3:]) + 1]))
    return "paper-literal", merged(*(part(r) for r in rung.split("+")))


def names_of_runs(out):
    try:
        with open(out + "/ladder_names.json", encoding="utf-8") as file:
            return json.load(file)
    except OSError:
        return {}


def lists(out, rye, rungs):
    literal = json.loads(subprocess.run(
        [rye, "train", "--preset", "paper-literal", "--print-config"], check=True,
        capture_output=True, text=True).stdout)
    names = []
    for rung in rungs:
        names += [r for r in SETS.get(rung, [rung]) if r not in names]
    rows, runs = {}, {}
    known = [r for rungs in SETS.values() for r in rungs] + list(PARTS) + names
    for name in known:
        # Rungs with one configuration share a run, in every call the same.
        preset, config = config_of(name, literal)
        runs.setdefault((preset, json.dumps(config, sort_keys=True)), name.replace("+", "_"))
    for name in names:
        preset, config = config_of(name, literal)
        run = runs[preset, json.dumps(config, sort_keys=True)]
        rows.setdefault(preset, []).append({"name": name, "run": run, "config": config})
    called = names_of_runs(out)  # what the rows of each run were called, in all calls
    for row in (row for preset in rows for row in rows[preset]):
        if row["name"] not in called.setdefault(row["run"], []):
            called[row["run"]].append(row["name"])
    with open(out + "/ladder_names.json", "w", encoding="utf-8") as file:
        json.dump(called, file, indent=1)
    for preset in ("paper-literal", "gpu"):
        path = f"{out}/ladder_{preset}.json"
        if os.path.exists(path):
            os.remove(path)
        if preset in rows:
            with open(path, "w", encoding="utf-8") as file:
                json.dump({"title": f"ladder from {preset}", "preset": preset,
                           "rows": rows[preset]}, file, indent=1)


def gaussians_of(run):
    """Returns the number of Gaussians in a run's checkpoint, or None."""
    try:
        with open(run + "/checkpoint.safetensors", "rb") as file:
            header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
    except OSError:
        return None
    return sum(header[name]["shape"][0] for name in ("avatar.face.xyz", "avatar.eyes.xyz")
               if name in header) or None


def measured(run, results):
    eyes = results["eyes_visible"]
    gaze, own = results["gaze"]["render"], results["gaze_without_labels"]["render"]
    return [results["head"]["psnr"], results["head"]["ssim"], results["eyes"]["psnr"],
            gaze["degrees"], gaze["degrees_where_found"],
            100 * gaze["found"] / eyes if eyes else None,
            own["degrees"], own["degrees_where_found"],
            100 * own["found"] / eyes if eyes else None, gaussians_of(run)]


HEAD = ["rung", "head [dB]", "SSIM", "eyes [dB]", "gaze [deg]", "... where found",
        "irises found [%]", "gaze without labels [deg]", "... where found", "irises found [%]",
        "Gaussians", "seconds"] + TITLES + ["runs"]
DIGITS = [2, 3, 2, 2, 2, 1, 2, 2, 1, 0, 0]


def spread(values, digits, unit=""):
    values = [v for v in values if v is not None]
    if not values:
        return "-"
    mean = sum(values) / len(values)
    text = f"{mean:.{digits}f}"
    if len(values) > 1 and digits > 0:
        variance = sum((v - mean) ** 2 for v in values) / (len(values) - 1)
        text += f" ± {variance ** 0.5:.{digits}f}"
    return text + unit


def table(out, split, group):
    seconds = {}  # by row, capture and seed: of training and measuring
    with open(out + "/compare.log", encoding="utf-8") as log:
        for line in log:
            found = re.match(r"\[\d+/\d+\] (.*): (\d+) s$", line)
            if found:
                seconds.setdefault(found[1], float(found[2]))
    called = names_of_runs(out)
    for capture in sorted(os.listdir(out + "/runs")):
        print(f"\n## {capture}, {split}, {group}\n\n| {' | '.join(HEAD)} |")
        print("|" + "---|" * len(HEAD))
        for preset in ("paper-literal", "gpu"):
            path = f"{out}/ladder_{preset}.json"
            if not os.path.exists(path):
                continue
            with open(path, encoding="utf-8") as file:
                rows = json.load(file)["rows"]
            for row in rows:
                folder = f"{out}/runs/{capture}/{row['run']}"
                found, judgements = [], []
                names = called[row["run"]]
                for seed in sorted(os.listdir(folder)) if os.path.isdir(folder) else []:
                    results = f"{folder}/{seed}/evaluation_{split}/results.json"
                    if not os.path.exists(results):
                        continue
                    with open(results, encoding="utf-8") as file:
                        results = json.load(file)
                    if group in results:
                        of = f"{capture}, {seed.replace('_', ' ')}"
                        took = [seconds[f"{n}, {of}"] for n in names if f"{n}, {of}" in seconds]
                        found.append(measured(f"{folder}/{seed}", results[group]) +
                                     [took[0] if took else None])
                        judgements.append(judged(f"{folder}/{seed}/evaluation_{split}", group))
                line = [spread([f[i] for f in found], d) for i, d in enumerate(DIGITS)]
                line += cells(judgements, spread)
                print(f"| {row['name']} | {' | '.join(line)} | {len(found)} |")


if sys.argv[1] == "lists":
    lists(sys.argv[2], sys.argv[3], sys.argv[4:])
else:
    table(*sys.argv[2:])
