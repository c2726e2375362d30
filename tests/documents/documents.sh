#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# documents.sh SOURCE_DIR: what README.md, CHANGELOG.md and the pages of docs/ link to, or name as a
# header or as a file of a folder of the project, exists; so do the files where CONTRIBUTING.md says
# that something is changed. A page of docs/ has at most 150 lines; one of
# docs/results/ says commit and machine. Prints how many words README.md and the pages of docs/ have.
set -eu
cd "$1"
bad=0
# File names here hold no spaces.
# shellcheck disable=SC2013,SC2016
for page in *.md docs/*.md docs/results/*.md; do
    folder=$(dirname "$page")
    # [text](target), without addresses and anchors
    for target in $({ grep -o '](\([^)]*\))' "$page" | sed 's/^](//; s/)$//; s/#.*//'
                      sed -n 's/^<img src="\([^"]*\)".*/\1/p' "$page"; } |
                    grep -v '^[a-z]*:' | sort -u); do
        [ -e "$folder/$target" ] || { echo "$page: no such file: $target"; bad=1; }
    done
    # `rye/folder/name.hpp` or <rye/folder/name.hpp>
    for header in $(grep -o '[`<]rye/[a-z0-9_/]*\.hpp[`>]' "$page" | tr -d '`<>' | sort -u); do
        [ -e "include/$header" ] || { echo "$page: no such header: $header"; bad=1; }
    done
    # `folder/name`
    for file in $(grep -oE '`(benchmarks|c|cmake|docs|examples|include|packaging|tests)/[A-Za-z0-9_./-]+' "$page" |
                  tr -d '`' | sort -u); do
        [ -e "$file" ] || { echo "$page: no such file: $file"; bad=1; }
    done
done
# `folder/name.hpp` below include/rye, examples/trainer, examples/gaze_page or the root
# shellcheck disable=SC2013,SC2016
for file in $(sed -n '/^## Where to change/,/^## Style/p' CONTRIBUTING.md |
              grep -oE '`[a-z_]+/[a-z_/]+\.(hpp|cpp|js|md|sh)' | tr -d '`' | sort -u); do
    [ -e "include/rye/$file" ] || [ -e "examples/trainer/$file" ] ||
        [ -e "examples/gaze_page/$file" ] || [ -e "$file" ] ||
        { echo "CONTRIBUTING.md: no such file: $file"; bad=1; }
done
for page in docs/*.md; do
    [ "$(wc -l < "$page")" -le 150 ] || { echo "$page: over 150 lines"; bad=1; }
done
# Words that people read: outside of code, with a letter or a digit.
words=$(for page in README.md docs/*.md; do awk '/^```/ { code = !code; next } !code' "$page"; done |
        tr -s ' \t|' '\n' | grep -c '[[:alnum:]]')
for page in docs/results/*.md; do
    grep -qi 'commit.*machine\|at every commit' "$page" || { echo "$page: no commit and machine"; bad=1; }
done
# VHAP ends in a KeyError where an export of meshes also cuts the masks, which is its default.
wrong=$(grep -rn -e '--flame-mode mesh' README.md docs examples | grep -v -e '--no-create-mask-from-mesh' || true)
[ -z "$wrong" ] || { echo "$wrong: expected --no-create-mask-from-mesh"; bad=1; }
[ $bad -eq 0 ] && echo "the documents name what exists; README.md and docs/*.md have $words words"
exit $bad
