#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# machine_code.sh COMPILER FLAGS_FILE HEADER: the loops of HEADER's run_chains have one product a
# chain, each in a register of its own and none in memory, for several sets of instructions of x86-64,
# whatever this machine has, and for every kind of vector. A compiler that sees equal chains keeps
# one. Where there are fused products, those are what the loop has.
set -eu
flags=$(tr '\n' ' ' < "$2")
bad=0

assembly() {  # OPTIONS
    # shellcheck disable=SC2086 # the flags and options are several words
    printf '#include "%s"\n%s\n%s\n' "$3" \
        "extern const int fused_here; const int fused_here = rye::bench::fuses;" \
        'void probe(int rounds) { rye::bench::each_vector_kind([=]<class V>(rye::bench::VectorKind<V>) {
             rye::bench::fused_products<V>(rounds); rye::bench::fused_products<V, 1>(rounds); }); }' |
        $1 $flags $4 -w -x c++ - -S -o -
}

for options in "-O3" "-O3 -march=x86-64-v4" "-O3 -march=x86-64-v3" "-O2 -march=x86-64"; do
    assembly "$1" "$2" "$3" "$options" | awk -v options="$options" '
        { line[NR] = $0 }
        /^[._A-Za-z][._A-Za-z0-9]*:/ { name = $1; sub(/:.*/, "", name); place[name] = NR }
        flag && $1 ~ /^\.(long|int|4byte)$/ { fused = $2; flag = 0 }
        flag && $1 ~ /^\.zero$/ { fused = 0; flag = 0 }
        /^fused_here:/ { flag = 1 }
        # A function: how many chains it has is the last argument of the template.
        /^_Z[A-Za-z0-9_]*run_chains[A-Za-z0-9_]*:/ {
            ++functions
            first[functions] = NR
            chains[functions] = name
            sub(/^.*Li/, "", chains[functions])
            sub(/E.*/, "", chains[functions])
            kind[functions] = "float"
            if (name ~ /ChainStepId|5batchId/) kind[functions] = "double"
        }
        # A jump back ends a loop; that with the most products is looked at.
        functions && $1 ~ /^j[a-z]+$/ && ($2 in place) && place[$2] > first[functions] {
            loops[functions] = loops[functions] " " place[$2] ":" NR
        }
        function look(from, to,    i, operand) {
            products = different = stack = 0
            split("", seen)
            for (i = from; i < to; ++i) {
                if (line[i] ~ /\(%[re][sb]p/) ++stack
                if (line[i] !~ (fused ? "\tvfn?madd[0-9]+p[sd]\t" : "\tv?mulp[sd]\t")) continue
                ++products
                operand = line[i]
                sub(/.*,[ \t]*%/, "", operand)
                sub(/[ \t].*/, "", operand)
                if (!(operand in seen)) { seen[operand] = 1; ++different }
                register = substr(operand, 1, 3)
            }
        }
        END {
            for (f = 1; f <= functions; ++f) {
                best = most = 0
                n = split(loops[f], loop, " ")
                for (l = 1; l <= n; ++l) {
                    split(loop[l], at, ":")
                    look(at[1], at[2])
                    if (products > most) { most = products; best = l }
                }
                if (best) { split(loop[best], at, ":"); look(at[1], at[2]) }
                good = best && products % chains[f] == 0 && different == chains[f] && !stack
                if (!good || chains[f] > 1)
                    printf "%s: %s: %d %s a loop in %d %s registers, of %d chains; %d operands on the stack\n",
                        options, kind[f], best ? products : 0, fused ? "fused products" : "products",
                        different, register, chains[f], stack
                if (!good) bad = 1
            }
            exit bad || functions < 4 || functions % 4
        }' || { echo "$options: expected a product a chain, in as many registers"; bad=1; }
done
[ $bad -eq 0 ] && echo "chains of products stay apart in the machine code"
exit $bad
