#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# rooms.sh EXAMPLES_DIR: a file of the trainer includes its own room and rooms before it in this
# list, never one after it, and names the room; a synthetic capture takes of the data only threads
# and how pictures and JSON are read.
set -eu
cd "$1"
order="data synthetic_capture driving model device corrections drawing training evaluation"
order="$order importers viewing commands"
# shellcheck disable=SC2016 # awk expands these
find synthetic_capture trainer -name '*.[ch]pp' | sort | xargs awk -v order="$order" '
    function fault(sentence) { print FILENAME ":" FNR ": " sentence; bad = 1 }
    BEGIN { n = split(order, name, " "); for (i = 1; i <= n; ++i) rank[name[i]] = i }
    FNR == 1 {
        split(FILENAME, part, "/"); here = part[1] == "trainer" ? part[2] : part[1]; ++files
        if (here == "main.cpp") here = "commands"
        if (!(here in rank)) fault("room " here " is not in the list")
    }
    /^ *# *include *"/ {
        split($0, quoted, "\""); split(quoted[2], part, "/"); there = part[1]
        if (!(there in rank)) fault("no room in \"" quoted[2] "\"")
        else if (rank[there] > rank[here]) fault(here " may not include " there)
        if (here == "synthetic_capture" && there == "data" && part[2] !~ /^(picture|json|threads|checksums|degrees)\.hpp$/)
            fault(here " may not include " quoted[2])
    }
    END { if (!bad) print files " files of the trainer include earlier rooms only"; exit bad }'
