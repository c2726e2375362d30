#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# rye: starts the program for the best level of x86-64 that this processor has, of those beside it.
# RYE_LEVEL of the environment chooses one, such as x86-64-v3.
here=$(cd "$(dirname "$(readlink -f "$0")")" && pwd)
flags=" $(sed -n 's/^flags[^:]*://p' "${RYE_CPUINFO:-/proc/cpuinfo}" | head -n 1) "
has() {
    for flag in "$@"; do
        case $flags in *" $flag "*) ;; *) return 1 ;; esac
    done
}
level=x86-64
if has avx avx2 bmi1 bmi2 f16c fma abm movbe; then level=x86-64-v3; fi
if [ $level = x86-64-v3 ] && has avx512f avx512bw avx512cd avx512dq avx512vl; then level=x86-64-v4; fi
level=${RYE_LEVEL:-$level}
while [ ! -x "$here/rye-$level" ]; do
    case $level in
        x86-64-v4) level=x86-64-v3 ;;
        x86-64-v3) level=x86-64 ;;
        *) echo "rye: no program rye-$level in $here" >&2; exit 2 ;;
    esac
done
exec "$here/rye-$level" "$@"
