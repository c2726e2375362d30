#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""tables.py OUT.json BASELINE.json|'' PAGE|'' PART.json...: joins Google Benchmark's files into one
and prints what they counted as tables, one a benchmark; changes against a baseline in per cent."""
import json
import os
import re
import sys

NOT_COUNTERS = {
    "name", "family_index", "per_family_instance_index", "run_name", "run_type", "repetitions",
    "repetition_index", "threads", "iterations", "real_time", "cpu_time", "time_unit",
    "aggregate_name", "label", "error_occurred", "error_message"}
BEGIN, END = "<!-- tables of benchmarks/run.sh -->", "<!-- end of tables -->"


def counters(row):
    return {k: v for k, v in row.items() if k not in NOT_COUNTERS}


def short(x):
    if x == 0:
        return "0"
    if abs(x) >= 1e4 or abs(x) < 1e-3:
        return f"{x:.2e}" if abs(x) < 1e-3 or abs(x) >= 1e7 else f"{x:.0f}"
    return f"{x:.3g}"


def family(name):
    return re.split(r"[/<]", name, maxsplit=1)[0]


def case(name):
    return re.sub(r"/iterations:\d+", "", name)[len(family(name)):].strip("/")


def table(title, rows, before):
    heads = list(dict.fromkeys(k for r in rows for k in counters(r)))
    lines = [f"### {title}", "", "| case | " + " | ".join(heads) + " |",
             "|---" * (len(heads) + 1) + "|"]
    for row in rows:
        old = before.get(row["name"], {})
        cells = []
        for h in heads:
            cell = short(row[h]) if h in row else ""
            if old.get(h):
                cell += f" ({100 * (row[h] / old[h] - 1):+.0f}%)"
            cells.append(cell)
        label = case(row["name"]).replace("rye::", "").replace("|", "/") or "all"
        lines.append("| " + " | ".join([label] + cells) + " |")
    return "\n".join(lines + [""])


def main():
    out, baseline, page, parts = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:]
    rows = []
    for part in parts:
        with open(part, encoding="utf-8") as f:
            rows += json.load(f)["benchmarks"]
    with open(out, "w", encoding="utf-8") as f:
        json.dump({"benchmarks": rows}, f, indent=1)
    before = {}
    if baseline:
        with open(baseline, encoding="utf-8") as f:
            before = {r["name"]: r for r in json.load(f)["benchmarks"]}
    families = {}
    for row in rows:
        families.setdefault(family(row["name"]), []).append(row)
    text = "\n".join(table(t, r, before) for t, r in families.items())
    print(text)
    if page and os.path.exists(page):
        with open(page, encoding="utf-8") as f:
            head, rest = f.read().split(BEGIN)
        with open(page, "w", encoding="utf-8") as f:
            f.write(head + BEGIN + "\n\n" + text + "\n" + END + rest.split(END)[1])


main()
