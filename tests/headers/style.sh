#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# style.sh INCLUDE_DIR: the rules of docs/architecture.md that a line-by-line look can check.
set -eu
cd "$1"
# shellcheck disable=SC2016 # awk expands these
find rye -name '*.hpp' | sort | xargs awk '
    function fault(sentence) { print FILENAME ":" FNR ": " sentence; bad = 1 }
    function end_of_file() {
        if (lines > 400) { print file ": " lines " lines, at most 400"; bad = 1 }
        if (file != "" && !once) { print file ": no #pragma once"; bad = 1 }
    }
    FNR == 1 {
        end_of_file(); file = FILENAME; once = 0; ++files
        split(file, part, "/"); folder = part[2]
        if ($0 != "// SPDX-License-Identifier: Apache-2.0") fault("first line is not the SPDX line")
    }
    FNR == 2 && index($0, "/// " FILENAME ": ") != 1 {
        fault("second line does not begin with /// " FILENAME ": ")
    }
    { lines = FNR; code = $0; sub(/\/\/.*/, "", code) }
    /^#pragma once/ { once = 1 }
    length($0) > 100 && !/^#error/ { fault("over 100 columns") }
    /\t/ { fault("tab") }
    /[ \t]$/ { fault("space at the end of the line") }
    code ~ /<Eigen\/(Dense|Eigen)>/ { fault("include Eigen/Core, or Geometry, not all of Eigen") }
    code ~ /<iostream>|std::(cout|cerr|clog)|[^a-z_]f?printf *\(/ { fault("a header prints nothing") }
    code ~ /# *include *<xsimd/ && folder != "backend" { fault("only backend/ includes xsimd") }
    code ~ /default_arch|xsimd::batch<(float|double|T)>/ && folder != "backend" {
        fault("the instruction set must be in the type: take it from the backend")
    }
    code ~ /# *pragma +omp|<omp\.h>/ && FILENAME != "rye/core/parallel.hpp" {
        fault("threads are started in core/parallel.hpp only")
    }
    code ~ /DefaultThreads/ && folder != "core" && folder != "backend" {
        fault("threads come from the backend type")
    }
    code ~ /^ *# *if/ && folder != "core" && folder != "backend" {
        fault("#if lives in core/ and backend/ only")
    }
    code ~ /^ *# *define/ && FILENAME != "rye/core/config.hpp" {
        fault("macros are defined in core/config.hpp only")
    }
    /TODO|FIXME|XXX/ { fault("unfinished") }
    END { end_of_file(); if (!bad) print files " headers keep the rules"; exit bad }'
