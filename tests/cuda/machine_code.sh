#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# machine_code.sh [--record] FLAGS_FILE RECORD [ARCHITECTURE...]: compiles kernels.cu for these, or for
# 75, 80, 90 and 90a, which has group_kernels.cu instead, where nvcc is, with warnings as errors, and
# holds registers, spilled bytes and machine instructions of each kernel against the record: at most
# 1.10 times, spills not at all more; products of groups must not wait for one another. An
# instruction is 16 bytes of a kernel's section. --record writes the record anew. nvcc: $NVCC, of the PATH, or of
# /usr/local/cuda. c++filt, of binutils as readelf, reads names; the record has them without namespaces.
set -eu
write=no
if [ "${1:-}" = --record ]; then
    write=yes
    shift
fi
here=$(cd "$(dirname "$0")" && pwd)
not_compiled="device_kernels: skipped, no nvcc is there, so no machine code was made for a device"
. "$here/../device/find_nvcc.sh"
# nvcc reads -isystem and its folder as two words.
flags_file=$1
record=$2
shift 2
[ $# -gt 0 ] || set -- 75 80 90 90a
includes="-isystem /usr/include/eigen3 $(sed -n 's/^-isystem/-isystem /p' "$flags_file" | tr '\n' ' ')"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

plain_names() {
    c++filt | sed -E 's/^(void )?rye::detail::run_kernel<//; s/(, [0-9]+ul)? ?>\([^()]*(\([^()]*\)[^()]*)*\)$//
        s/rye:://g; s/detail:://g; s/[{][^}]*[}]//g; s/ //g'
}

for architecture; do
    source=kernels.cu
    if [ "$architecture" = 90a ]; then source=group_kernels.cu; fi
    # shellcheck disable=SC2086 # the folders are several words
    "$nvcc" -std=c++20 -O3 -DNDEBUG -DEIGEN_DONT_PARALLELIZE --fmad=false -Werror all-warnings \
        -diag-suppress 20012,20015 -I"$here/../../include" $includes \
        -gencode "arch=compute_$architecture,code=sm_$architecture" -cubin -Xptxas -v \
        -o "$work/kernels.cubin" "$here/$source" 2> "$work/log" ||
        { cat "$work/log"; exit 1; }
    if grep "wgmma.* serialized" "$work/log"; then exit 1; fi
    awk -v sm="sm_$architecture" '
        /Compiling entry function/ { split($0, part, "\047"); name = part[2] }
        /bytes stack frame/ { spill[name] = $5 }
        /Used [0-9]+ registers/ {
            for (i = 1; i <= NF; ++i) if ($i == "Used") print sm, name, $(i + 1), spill[name]
        }' "$work/log" > "$work/registers"
    # A section of code is named after its kernel.
    readelf -SW "$work/kernels.cubin" 2> /dev/null |
        sed -n 's/.* \.text\.\([^ ]*\) *PROGBITS *[0-9a-f]* [0-9a-f]* \([0-9a-f]*\) .*/\1 \2/p' |
        while read -r name size; do echo "$name $((0x$size / 16))"; done > "$work/sizes"
    awk 'NR == FNR { size[$1] = $2; next } { print $1, $2, $3, $4, size[$2] }' \
        "$work/sizes" "$work/registers" > "$work/kernels"
    cut -d' ' -f2 "$work/kernels" | plain_names > "$work/names"
    paste -d' ' "$work/names" "$work/kernels" | awk '{ print $2, $1, $4, $5, $6 }' |
        sort >> "$work/found"
done
if [ $write = yes ]; then
    { echo "# architecture kernel registers spilled-bytes instructions"; cat "$work/found"; } \
        > "$record"
    echo "device_kernels: the record has $(wc -l < "$work/found") kernels"
    exit 0
fi
awk '
    /^#/ { next }
    NR == FNR { registers[$1 $2] = $3; spill[$1 $2] = $4; size[$1 $2] = $5; next }
    {
        ++kernels; key = $1 $2
        if (!(key in size)) { print "no record of " $1 " " $2; bad = 1; next }
        if ($3 > 1.10 * registers[key]) {
            print $1 " " $2 ": " $3 " registers, recorded " registers[key]; bad = 1 }
        if ($4 > spill[key]) { print $1 " " $2 ": spills " $4 " bytes, recorded " spill[key]; bad = 1 }
        if ($5 > 1.10 * size[key]) {
            print $1 " " $2 ": " $5 " instructions, recorded " size[key]; bad = 1 }
    }
    END { if (!bad) print kernels " kernels of '"$*"' keep the record"; exit bad }
' "$record" "$work/found"
