#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# links.sh SITE: every page, file and anchor of the site that a page of it links to is there.
# Addresses of other sites are not asked for.
set -eu
cd "$1"
trap 'rm -f ../links.pages ../links.files ../links.txt' EXIT
find . -name '*.html' ! -path './live/*' ! -path './search/*' | sed 's|^\./||' | sort > ../links.pages
find . -type f | sed 's|^\./||' | sort > ../links.files
# Doxygen ends tags on the line that they begin on.
# shellcheck disable=SC2016 # awk expands these
xargs awk '
    BEGIN { while ((getline line < "../links.files") > 0) there[line] = 1 }
    {
        rest = $0
        while (match(rest, /(href|src|id|name)="[^"]*"/)) {
            word = substr(rest, RSTART, RLENGTH); rest = substr(rest, RSTART + RLENGTH)
            split(word, part, "\""); value = part[2]
            if (word ~ /^(id|name)/) anchor[FILENAME "#" value] = 1
            else if (value !~ /^([a-z]+:|$)/) {
                if (value ~ /^#/) value = FILENAME value
                if (!(value in from)) from[value] = FILENAME
            }
        }
    }
    END {
        for (value in from) {
            ++count
            file = value; sub(/#.*/, "", file)
            if (!(file in there)) { print from[value] ": no such file: " value; bad = 1 }
            else if (value ~ /#./ && !(value in anchor)) { print from[value] ": no such anchor: " value; bad = 1 }
        }
        if (!bad) print count " links lead to what is there"
        exit bad
    }' < ../links.pages > ../links.txt || { head -n 40 ../links.txt; exit 1; }
cat ../links.txt
