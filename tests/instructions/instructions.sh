#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# instructions.sh PROGRAM RECORD COMPILER [--record]: counts the instructions of the main kernels
# with callgrind and fails above 1.10 times those recorded, whatever else the machine does. A count
# holds for one compiler: with another, and without valgrind, the check is skipped.
set -eu
program=$1
record=$2
compiler=$3

if ! command -v valgrind > /dev/null; then
    echo "instructions: skipped, there is no valgrind (Debian: valgrind)"
    exit 77
fi
count() {  # KERNEL: its function is the name up to the dot
    valgrind --tool=callgrind --callgrind-out-file=/dev/null --toggle-collect="${1%.*}" \
        "$program" "$1" 2>&1 | sed -n 's/.*Collected : \([0-9]*\).*/\1/p'
}
kernels="splat_forward.3 splat_backward.3 splat_forward.32 splat_backward.32"
kernels="$kernels mlp_forward mlp_backward"
if [ "${4:-}" = --record ]; then
    {
        echo "# Instructions of one call, by tests/instructions/instructions.sh --record."
        echo "compiler $compiler"
        for kernel in $kernels; do echo "$kernel $(count "$kernel")"; done
    } > "$record.new"
    mv "$record.new" "$record"
    exit 0
fi
if ! grep -qx "compiler $compiler" "$record"; then
    echo "instructions: skipped, the record is of another compiler than $compiler"
    exit 77
fi
bad=0
for kernel in $kernels; do
    now=$(count "$kernel")
    then=$(sed -n "s/^$kernel //p" "$record")
    echo "$kernel: $now instructions, recorded $then"
    [ -n "$now" ] && [ -n "$then" ] && [ "$((now * 100))" -le "$((then * 110))" ] || {
        echo "$kernel: more than 1.10 times the record"
        bad=1
    }
done
exit $bad
