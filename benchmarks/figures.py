# SPDX-License-Identifier: Apache-2.0
"""figures.py OUT CAPTURE VARIANT...: what figures.sh has measured, as a table in Markdown."""
import json
import os
import sys

from judged import TITLES, cells, judged

NAMES = {
    "measured": "`--preset {preset}`",
    "unmeasured": "with `measured_eyes = false`",
    "euclidean": 'with `avatar.metric = "euclidean"`',
    "round": "with `gaussians.eyeball.thickness = 1`",
}
GROUPS = {"novel gaze": "new directions", "independent eyes": "eyes apart"}


def number(value, form):
    return "-" if value is None else format(value, form)


def row(name, group, results, judgement):
    labelled, own = results["gaze"], results["gaze_without_labels"]
    visible = results["eyes_visible"]

    def found(table):
        return f"{table['photograph']['found']}, {table['render']['found']} of {visible}"

    line = [
        name,
        group,
        number(results["head"]["psnr"], ".1f") + ", " + number(results["head"]["ssim"], ".3f"),
        number(results["eyes"]["psnr"], ".1f"),
        number(labelled["render"]["degrees"], ".1f") + "°",
        number(labelled["at_rest"]["degrees"], ".1f") + "°",
        number(labelled["nearest_training"]["degrees"], ".1f") + "°",
        number(labelled["photograph"]["degrees_to_label"], ".1f") + "°",
        found(labelled),
        number(own["render"]["degrees"], ".1f") + "°",
        found(own),
    ]
    line += cells([judgement], lambda values, digits, unit: number(values[0], f".{digits}f") + unit)
    return "| " + " | ".join(line) + " |"


def main():
    out, capture, variants = sys.argv[1], sys.argv[2], sys.argv[3:]
    print(
        "| training | frames | PSNR [dB], SSIM of the head | PSNR of the eyes [dB] | gaze error "
        "| ... at rest | ... nearest training gaze | estimator to label "
        "| irises found: photograph, render | without labels: gaze error | irises found | "
        + " | ".join(TITLES) + " |"
    )
    print("|" + "---|" * (11 + len(TITLES)))
    notes = []
    for variant in variants:
        run = os.path.join(out, variant)
        with open(os.path.join(run, "results.json"), encoding="utf-8") as file:
            results = json.load(file)
        with open(os.path.join(run, "config.json"), encoding="utf-8") as file:
            name = NAMES[variant].format(preset=json.load(file)["preset"])
        groups = [g for g in GROUPS if g in results]
        for group in groups:
            print(row(name, GROUPS[group], results[group], judged(run, group)))
        if not groups:
            print(row(name, "all", results["all"], judged(run)))
        with open(os.path.join(run, "seconds"), encoding="utf-8") as file:
            seconds = sum(int(line) for line in file)
        notes.append(f"{variant}: trained {results['step']} steps of stage 2 in {seconds} s")
    missed = results["missed_degrees"]
    print(f"\nA visible eye without an iris on one of the two pictures counts {missed:.0f}°.")
    print(f"{os.cpu_count()} processors; " + "; ".join(notes) + ".")


if __name__ == "__main__":
    main()
