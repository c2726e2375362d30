#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""plot.py accuracy.csv FIGURE.svg: error against time of every policy and knob, the worst of all
scenes, on logarithmic axes; what nothing else beats in both is joined by a line. Prints the same as
a table for docs/results/accuracy.md."""
import csv
import math
import sys

WIDTH, HEIGHT, LEFT, BOTTOM, TOP, RIGHT = 760, 460, 70, 50, 20, 20
COLOUR = {"preset": "#1f4e9c", "alpha_min": "#c0392b", "alpha_max": "#8e44ad", "stop": "#d68910",
          "support": "#117864", "exp2": "#5d6d7e", "backend": "#000000"}


def rows(path):
    with open(path, newline="") as f:
        for r in csv.DictReader(f):
            if r["scene"] == "worst of all":
                yield r


def number(text):
    x = float(text)
    return "–" if math.isnan(x) else "%.1e" % x


def table(data):
    print("| kind | what | max | RMS | dB | gradient, relative | 1 - cosine | forward | with gradient |")
    print("|---|---|---|---|---|---|---|---|---|")
    for r in data:
        times = ["–" if math.isnan(float(r[k])) else "%.2f" % float(r[k])
                 for k in ("forward_ratio", "both_ratio")]
        decibels = "%.1f" % float(r["psnr_db"]) if float(r["psnr_db"]) < 900 else "–"
        print("| %s | %s | %s | %s | %s | %s | %s | %s | %s |" % (
            r["kind"], r["name"], number(r["max"]), number(r["rms"]), decibels,
            number(r["gradient_relative"]), number(r["gradient_one_minus_cosine"]), *times))


def figure(data, path):
    points = [(float(r["both_ratio"]), float(r["rms"]), r) for r in data
              if not math.isnan(float(r["both_ratio"])) and float(r["rms"]) > 1e-12
              and float(r["both_ratio"]) < 4]
    x0, x1 = math.log10(0.25), math.log10(1.4)
    y0, y1 = -7.0, -2.0

    def place(t, e):
        x = LEFT + (math.log10(t) - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT)
        y = HEIGHT - BOTTOM - (math.log10(e) - y0) / (y1 - y0) * (HEIGHT - BOTTOM - TOP)
        return x, y

    out = ['<svg xmlns="http://www.w3.org/2000/svg" width="%d" height="%d" '
           'font-family="sans-serif" font-size="11">' % (WIDTH, HEIGHT),
           '<rect width="100%" height="100%" fill="white"/>']
    for e in range(int(y0), int(y1) + 1):
        y = place(1, 10.0 ** e)[1]
        out.append('<path d="M%d %.1fH%d" stroke="#ddd"/>' % (LEFT, y, WIDTH - RIGHT))
        out.append('<text x="%d" y="%.1f" text-anchor="end">1e%d</text>' % (LEFT - 6, y + 4, e))
    for t in (0.25, 0.35, 0.5, 0.7, 1.0, 1.4):
        x = place(t, 1e-5)[0]
        out.append('<path d="M%.1f %dV%d" stroke="#ddd"/>' % (x, TOP, HEIGHT - BOTTOM))
        out.append('<text x="%.1f" y="%d" text-anchor="middle">%.2f</text>'
                   % (x, HEIGHT - BOTTOM + 16, t))
    out.append('<text x="%d" y="%d" text-anchor="middle">time with the gradient, of Exact32\'s'
               '</text>' % ((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 12))
    out.append('<text x="16" y="%d" transform="rotate(-90 16 %d)" text-anchor="middle">RMS error, '
               'worst scene</text>' % (HEIGHT / 2, HEIGHT / 2))
    front, best = [], math.inf
    for t, e, r in sorted(points, key=lambda p: (p[0], p[1])):
        if e < best:
            best = e
            front.append(place(t, e))
    out.append('<polyline fill="none" stroke="#1f4e9c" stroke-dasharray="4 3" points="%s"/>'
               % " ".join("%.1f,%.1f" % p for p in front))
    taken = []
    for t, e, r in sorted(points, key=lambda p: p[2]["kind"] != "preset"):
        x, y = place(t, e)
        colour = COLOUR.get(r["kind"], "#000")
        size = 5 if r["kind"] == "preset" else 3
        out.append('<circle cx="%.1f" cy="%.1f" r="%d" fill="%s"/>' % (x, y, size, colour))
        ty = y + 4
        while any(abs(ty - b) < 11 and abs(x - a) < 130 for a, b in taken):
            ty += 11
        taken.append((x, ty))
        right = x < WIDTH - 150
        out.append('<text x="%.1f" y="%.1f" fill="%s" text-anchor="%s">%s</text>'
                   % (x + (8 if right else -8), ty, colour, "start" if right else "end", r["name"]))
    out.append("</svg>")
    with open(path, "w") as f:
        f.write("\n".join(out) + "\n")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    everything = list(rows(sys.argv[1]))
    table(everything)
    figure(everything, sys.argv[2])
