#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# precompile.sh COMPILER FLAGS_FILE FOLDER: FOLDER/eigen.hpp and its precompiled form, with the flags
# of a user, for the checks that parse many small units: most of such a unit is Eigen.
set -eu
flags=$(tr '\n' ' ' < "$2")
mkdir -p "$3"
echo '#include <Eigen/Core>' > "$3/eigen.hpp"
# shellcheck disable=SC2086 # the flags are several words
$1 $flags -x c++-header "$3/eigen.hpp" -o "$3/eigen.hpp.gch"
