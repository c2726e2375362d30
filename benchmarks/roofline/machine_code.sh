#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# machine_code.sh COMPILER FLAGS_FILE HEADER [CHAINS]: the loop of HEADER's fused_products has one
# product a chain, each in a register of its own and none in memory, for several sets of
# instructions of x86-64, whatever this machine has. A compiler that sees equal chains keeps one.
# CHAINS: how many there are; default: what the header's constant says.
set -eu
flags=$(tr '\n' ' ' < "$2")
bad=0

assembly() {  # OPTIONS
    # shellcheck disable=SC2086 # the flags and options are several words
    printf '#include "%s"\n%s\n%s\n' "$3" \
        "extern const int chains_counted; const int chains_counted = ${4:-rye::bench::chains};" \
        'void probe(int rounds) { rye::bench::fused_products(rounds); }' |
        $1 $flags $5 -w -x c++ - -S -o -
}

for options in "-O3" "-O3 -march=x86-64-v4" "-O3 -march=x86-64-v3" "-O2 -march=x86-64"; do
    assembly "$1" "$2" "$3" "${4:-}" "$options" | awk -v options="$options" '
        { line[NR] = $0 }
        /^[._A-Za-z][._A-Za-z0-9]*:/ { name = $1; sub(/:.*/, "", name); place[name] = NR }
        after && $1 ~ /^\.(long|int|4byte)$/ { chains = $2; after = 0 }
        /^chains_counted:/ { after = 1 }
        # A jump back ends a loop; that with the most products is looked at.
        $1 ~ /^j[a-z]+$/ && ($2 in place) {
            products = registers = memory = 0
            split("", seen)
            for (i = place[$2]; i < NR; ++i) {
                if (line[i] ~ /\(%[re][sb]p/) ++memory
                if (line[i] !~ /\t(vfn?madd[0-9]+ps|vmulps|mulps)\t/) continue
                ++products
                to = line[i]
                sub(/.*,[ \t]*/, "", to)
                if (!(to in seen)) { seen[to] = 1; ++registers }
            }
            if (products > most) { most = products; different = registers; stack = memory }
        }
        END {
            printf "%s: %d products a loop in %d registers, of %d chains; %d operands on the stack\n",
                options, most, different, chains, stack
            exit !(chains > 0 && most > 0 && most % chains == 0 && different == chains && !stack)
        }' || { echo "$options: expected a product a chain, in as many registers"; bad=1; }
done
[ $bad -eq 0 ] && echo "chains of products stay apart in the machine code"
exit $bad
