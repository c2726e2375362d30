#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# layers.sh INCLUDE_DIR: a header includes its own folder and folders before it in this list, never
# one after it. rye/rye.hpp stands above all folders. backend/lanes.hpp, and with it xsimd, is
# included by backend/ and by subfolders named lanes/ alone; these by their folder's headers alone.
set -eu
cd "$1"
order="core backend math autodiff geometry gaussian splat nn rig loss avatar interactive io train"
# shellcheck disable=SC2016 # awk expands these
find rye -mindepth 2 -name '*.hpp' | sort | xargs awk -v order="$order" '
    BEGIN { n = split(order, name, " "); for (i = 1; i <= n; ++i) rank[name[i]] = i }
    FNR == 1 {
        split(FILENAME, part, "/"); here = part[2]; ++files
        if (!(here in rank)) { print FILENAME ": folder " here " is not in the list"; bad = 1 }
    }
    /^ *# *include *<rye\// {
        split($0, part, "/"); there = part[2]
        if (!(there in rank) || rank[there] > rank[here]) {
            print FILENAME ":" FNR ": " here " may not include " there; bad = 1
        }
        lanes = FILENAME ~ /^rye\/[a-z]+\/lanes\//
        if ($0 ~ /<rye\/backend\/lanes.hpp>/ && !lanes && here != "backend") {
            print FILENAME ":" FNR ": only backend and folders lanes include backend/lanes.hpp"
            bad = 1
        }
        if ($0 ~ /<rye\/[a-z]+\/(lanes|plain)\// && here != there) {
            print FILENAME ":" FNR ": " here " may not include a subfolder of " there; bad = 1
        }
        if ($0 ~ /<rye\/[a-z]+\/lanes\// && FILENAME ~ /\/plain\//) {
            print FILENAME ":" FNR ": plain loops may not include lanes"; bad = 1
        }
    }
    END { if (!bad) print files " headers include downward only"; exit bad }'
