#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""mutants.py [--count N] [--seed S] [--minutes M] [--compiler "g++ ..."]: breaks the adjoints of the
headers, one sign or one factor at a time, and counts how many of the broken ones the laws notice.

A mutant is a copy of one header with one change inside a function whose name says that it is a
derivative (vjp, slope, cotangent). The law program of that header is compiled against it, first
derivatives in double only, and run. A mutant that does not compile is not counted."""
import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time

HERE = os.path.dirname(os.path.abspath(__file__))
INCLUDE = os.path.join(HERE, "..", "..", "include")
PROGRAM = {
    "rye/math/linalg.hpp": "rotation",
    "rye/math/rotation.hpp": "rotation",
    "rye/math/harmonics.hpp": "harmonics",
    "rye/nn/encoding.hpp": "harmonics",
    "rye/rig/influence.hpp": "harmonics",
    "rye/gaussian/project.hpp": "project",
    "rye/gaussian/sh_color.hpp": "project",
    "rye/splat/blend.hpp": "splat",
    "rye/splat/plain/vjp.hpp": "splat",
    "rye/splat/falloff.hpp": "splat",
    "rye/geometry/mesh.hpp": "geometry",
    "rye/geometry/marching_tets.hpp": "geometry",
    "rye/loss/mesh_terms.hpp": "geometry",
}
# Reached by no law program: the value of the slope where no draw goes, or another type's adjoint.
SKIPPED = {"sh_colors_vjp"}
ADJOINT = re.compile(r"\b(\w*(?:vjp|slope|cotangent)\w*|silhouette_term|sum_of_squares)\s*\(")
CHANGES = [
    (re.compile(r" \+ "), " - ", "+ becomes -"),
    (re.compile(r" - "), " + ", "- becomes +"),
    (re.compile(r" \+= "), " -= ", "+= becomes -="),
    (re.compile(r" -= "), " += ", "-= becomes +="),
    (re.compile(r"\b(?:T\(-?[\d.]+\)|two|square) \* "), "", "a constant is dropped"),
    (re.compile(r"(?<=[=(,+] )-(?=\w)|(?<=\()-(?=\w)"), "", "a sign is dropped"),
    (re.compile(r" \* (?!T\()\w+(?:\.\w+|\[\w+\]|->\w+)*(?![\w(\[<.])"), "", "a factor is dropped"),
]


def bodies(text):
    """Ranges of the bodies of adjoints, and their names."""
    for m in ADJOINT.finditer(text):
        depth, i = 0, m.end() - 1
        while i < len(text):                         # past the arguments
            depth += {"(": 1, ")": -1}.get(text[i], 0)
            i += 1
            if depth == 0:
                break
        j = i
        while j < len(text) and text[j] in " \n" or text.startswith("const", j):
            j += 5 if text.startswith("const", j) else 1
        if j >= len(text) or text[j] != "{" or m.group(1) in SKIPPED:
            continue
        depth, k = 0, j
        while k < len(text):
            depth += {"{": 1, "}": -1}.get(text[k], 0)
            k += 1
            if depth == 0:
                break
        yield m.group(1), j, k


def sites():
    for header in PROGRAM:
        with open(os.path.join(INCLUDE, header)) as f:
            text = f.read()
        for name, begin, end in bodies(text):
            for pattern, by, what in CHANGES:
                for m in pattern.finditer(text, begin, end):
                    line = text.rfind("\n", 0, m.start()) + 1
                    source = text[line:text.find("\n", m.start())]
                    code = source.split("//")[0]
                    loop = re.search(r"for \([^;]*;[^;]*;[^)]*\)", code)
                    at = m.start() - line
                    if at >= len(code) or loop and loop.start() <= at < loop.end():
                        continue
                    if re.search(r"RYE_ASSERT|Index\(|const Index |static_cast<", code):
                        continue
                    yield header, name, m.start(), m.end(), by, what, source.strip()


def main():
    p = argparse.ArgumentParser()
    p.add_argument("--count", type=int, default=200)
    p.add_argument("--seed", type=int, default=1)
    p.add_argument("--minutes", type=float, default=120)
    p.add_argument("--each", type=int, default=40, help="at most so many of a function")
    p.add_argument("--draws", type=int, default=200)
    p.add_argument("--only", default="", help="functions of this name alone")
    p.add_argument("--compiler", default="g++ -std=c++20 -O0 -DEIGEN_DONT_PARALLELIZE "
                   "-march=native -isystem /usr/include/eigen3")
    o = p.parse_args()
    everything = sorted(s for s in set(sites()) if o.only in ("", s[1]))
    random.Random(o.seed).shuffle(everything)
    seen = {}                                            # the harmonics are half of all sites
    everything = [s for s in everything
                  if seen.setdefault(s[:2], []).append(s) or len(seen[s[:2]]) <= o.each]
    work = tempfile.mkdtemp(prefix="rye-mutants-")
    caught, survived, stillborn = 0, [], 0
    start = time.time()

    def verdict(program, overlay):
        binary = os.path.join(work, "laws")
        command = o.compiler.split() + ["-w", "-DRYE_QUICK_LAWS", "-I" + overlay, "-I" + INCLUDE,
                                        os.path.join(HERE, "laws_%s.cpp" % program), "-o", binary]
        if subprocess.run(command, stderr=subprocess.DEVNULL).returncode != 0:
            return None
        try:
            return subprocess.run([binary, str(o.draws)], stdout=subprocess.DEVNULL,
                                  timeout=120).returncode == 0
        except subprocess.TimeoutExpired:
            return False

    try:
        for program in sorted(set(PROGRAM.values())):    # nothing is proved by laws that fail anyway
            if verdict(program, work) is not True:
                sys.exit("laws_%s fails without a mutant" % program)
        for header, name, begin, end, by, what, source in everything:
            if caught + len(survived) >= o.count or time.time() - start > 60 * o.minutes:
                break
            with open(os.path.join(INCLUDE, header)) as f:
                text = f.read()
            path = os.path.join(work, header)
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, "w") as f:
                f.write(text[:begin] + by + text[end:])
            passed = verdict(PROGRAM[header], work)
            os.remove(path)
            if passed is None:
                stillborn += 1
            elif passed:
                survived.append((header, name, what, source))
                print("survived: %s, %s: %s: %s" % survived[-1], flush=True)
            else:
                caught += 1
    finally:
        shutil.rmtree(work)
    tried = caught + len(survived)
    print("%d sites; %d mutants tried, %d caught (%.1f %%), %d survived; %d did not compile" %
          (len(everything), tried, caught, 100.0 * caught / max(1, tried), len(survived),
           stillborn))
    return 0 if tried and caught >= 0.95 * tried else 1


if __name__ == "__main__":
    sys.exit(main())
