# SPDX-License-Identifier: Apache-2.0
"""judged.py: the numbers of judge.json (judge/judge.sh) as columns of the tables that other scripts print."""
import json
import os

# Title, digits, unit, and where a group of judge.json has it.
COLUMNS = [
    ("judge: gaze", 2, "°", ("gaze", "degrees")),
    ("irises [% of an eye's width]", 1, "", ("irises",)),
    ("eyeBlink", 3, "", ("blink",)),
    ("landmarks [% of the eyes' distance]", 2, "", ("landmarks",)),
    ("52 coefficients", 3, "", ("coefficients",)),
    ("identity", 3, "", ("identity",)),
]
TITLES = [title for title, _, _, _ in COLUMNS]


def judged(evaluation, group="all"):
    """Returns a number, or None, for each column: of a group of frames of an evaluation's folder."""
    try:
        with open(os.path.join(evaluation, "judge.json"), encoding="utf-8") as file:
            found = json.load(file).get(group)
    except FileNotFoundError:
        found = None
    values = []
    for _, _, _, keys in COLUMNS:
        value = found
        for key in keys:
            value = value.get(key) if isinstance(value, dict) else None
        values.append(value)
    return values


def cells(runs, shown):
    """Returns a table's cells of runs, each as judged() returns it; shown(numbers, digits, unit) is a
    number's text. "not run" where no run has a number."""
    out = []
    for i, (_, digits, unit, _) in enumerate(COLUMNS):
        numbers = [run[i] for run in runs if run[i] is not None]
        out.append(shown(numbers, digits, unit) if numbers else "not run")
    return out
