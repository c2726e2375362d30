#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""tables.py OUT.json BASELINE.json|'' PAGE|'' PART...: joins Google Benchmark's files (PART.json)
into one and prints what they counted as tables, one a benchmark, then the tables in PART.md; changes
against a baseline in per cent. PAGE and the figure in ../images get what does not depend on the
machine: counts and ratios, and nanoseconds as multiples of the first case's."""
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


def of_the_machine(counter):
    return counter.endswith(("_ms", "_s")) or counter == "lanes"


def nanoseconds(counter):
    return counter == "ns" or counter.startswith("ns_")


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


def table(title, rows, before, lasting):
    heads = list(dict.fromkeys(k for r in rows for k in counters(r)))
    if lasting:
        heads = [h for h in heads if not of_the_machine(h)]
    if not heads:
        return ""
    shown = [h.replace("ns_per_", "time a ").replace("ns", "time") + " / first"
             if lasting and nanoseconds(h) else h for h in heads]
    labelled = any(r.get("label") for r in rows)  # the processor that it was measured on
    if labelled:
        shown.append("processor")
    lines = [f"### {title}", "", "| case | " + " | ".join(shown) + " |",
             "|---" * (len(shown) + 1) + "|"]
    for row in rows:
        old = before.get(row["name"], {})
        cells = []
        for h in heads:
            unit = rows[0].get(h, 1) if lasting and nanoseconds(h) else 1
            cell = short(row[h] / unit) if h in row else ""
            if old.get(h) and not lasting:
                cell += f" ({100 * (row[h] / old[h] - 1):+.0f}%)"
            cells.append(cell)
        if labelled:
            cells.append(row.get("label", ""))
        label = case(row["name"]).replace("rye::", "").replace("|", "/") or "all"
        lines.append("| " + " | ".join([label] + cells) + " |")
    return "\n".join(lines + ["", ""])


def bars(rows, path):
    """The walks against the yardstick: how many times as fast."""
    out, y = [], 34
    most = max(r["fwd_ratio"] for r in rows)
    for r in rows:
        label = case(r["name"]).replace("n:", "").replace("/c:", " Gaussians, C = ")
        out.append(f'<text x="176" y="{y + 17}" text-anchor="end">{label}</text>')
        for key, colour in (("fwd_ratio", "#1f4e9c"), ("both_ratio", "#d68910")):
            width = 430 * r[key] / most
            out.append(f'<rect x="184" y="{y}" width="{width:.0f}" height="12" fill="{colour}"/>')
            out.append(f'<text x="{190 + width:.0f}" y="{y + 11}">{r[key]:.1f}</text>')
            y += 14
        y += 14
    head = (f'<svg xmlns="http://www.w3.org/2000/svg" width="680" height="{y}" '
            'font-family="sans-serif" font-size="12"><rect width="100%" height="100%" '
            'fill="white"/><rect x="184" y="10" width="12" height="12" fill="#1f4e9c"/>'
            '<text x="200" y="20">forward</text><rect x="264" y="10" width="12" height="12" '
            'fill="#d68910"/><text x="280" y="20">forward and gradient; times as fast as the '
            'yardstick, one thread</text>')
    with open(path, "w", encoding="utf-8") as f:
        f.write(head + "\n".join(out) + "</svg>\n")


def main():
    out, baseline, page, parts = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4:]
    rows, texts = [], []
    for part in parts:
        with open(part, encoding="utf-8") as f:
            if part.endswith(".md"):
                texts.append(f"### {os.path.basename(part)[:-3]}\n\n{f.read()}\n")
            else:
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

    def text(lasting):
        return "".join([table(t, r, before, lasting) for t, r in families.items()] + texts)

    print(text(False))
    if page and os.path.exists(page):
        with open(page, encoding="utf-8") as f:
            head, rest = f.read().split(BEGIN)
        with open(page, "w", encoding="utf-8") as f:
            f.write(head + BEGIN + "\n\n" + text(True) + END + rest.split(END)[1])
        if "against_naive" in families:
            bars(families["against_naive"],
                 os.path.join(os.path.dirname(page) or ".", "..", "images", "performance.svg"))


main()
