#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# seconds.sh: read by the scripts beside it, which set work, cxx and flags.

# Compiles $work/NAME.cpp to $work/NAME.o; user time of the fastest of three [s].
seconds() { # NAME
    python3 - "$work/$1.o" $cxx $flags -c "$work/$1.cpp" <<'PY'
import resource, subprocess, sys
best = 1e9
for _ in range(3):
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    subprocess.run(sys.argv[2:] + ["-o", sys.argv[1]], check=True)
    best = min(best, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
print(best)
PY
}
