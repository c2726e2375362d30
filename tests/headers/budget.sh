#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# budget.sh COMPILER FLAGS_FILE: what including the rasterizer costs, in preprocessed lines: at most
# 1.5 times Eigen/Core and xsimd, which it cannot do without.
set -eu
cxx=$1
flags=$(tr '\n' ' ' < "$2")

lines() {  # HEADER...
    for header; do echo "#include <$header>"; done |
        # shellcheck disable=SC2086 # the flags are several words
        $cxx $flags -E -P -x c++ - | wc -l
}
own=$(lines rye/splat/rasterizer.hpp)
base=$(lines Eigen/Core xsimd/xsimd.hpp)
echo "rye/splat/rasterizer.hpp: $own lines; Eigen/Core and xsimd: $base"
[ "$((own * 2))" -le "$((base * 3))" ]
