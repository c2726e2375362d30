#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# command_lines.sh RYE PAGE WORK: runs the command lines of the page's ```console blocks and compares
# answer and exit code with what the page says: a line "$ rye ...", the lines of standard output and
# then standard error ("..." stands for any further ones), a line "exit code N". They run in a
# folder that holds empty folders RUN, CAPTURE and EMPTY and a file path.json; those that fail write
# nothing there.
set -eu
rye=$1
page=$2
work=$3
rm -rf "$work"
mkdir -p "$work/cases" "$work/here/RUN" "$work/here/CAPTURE" "$work/here/EMPTY"
echo '{}' > "$work/here/path.json"

awk -v to="$work/cases/" '
    /^```console$/ { inside = 1; next }
    /^```/ { inside = 0 }
    !inside { next }
    /^\$ / { open = 1; name = sprintf("%s%03d", to, ++n); print substr($0, 3) > (name ".line"); next }
    !open { next }
    /^exit code / { open = 0; print $3 > (name ".code"); printf "" > (name ".answer"); next }
    { print > (name ".answer") }' "$page"

passed=0 failed=0 wrong=0
before=$(find "$work/here" | sort)
for line in "$work"/cases/*.line; do
    case=${line%.line}
    words=$(cat "$line")
    [ -e "$case.code" ] || { echo "$page: no exit code after: $words"; exit 1; }
    case $words in
    rye | "rye "*) ;;
    *) echo "$page: not a command line of rye: $words"; exit 1 ;;
    esac
    code=0
    (cd "$work/here" && eval "set -- ${words#rye}" && exec "$rye" "$@") \
        > "$case.out" 2> "$case.err" || code=$?
    cat "$case.out" "$case.err" > "$case.got"
    if grep -qx '\.\.\.' "$case.answer"; then
        sed '/^\.\.\.$/,$d' "$case.answer" > "$case.first"
        head -n "$(wc -l < "$case.first")" "$case.got" > "$case.begin"
        mv "$case.begin" "$case.got"
        mv "$case.first" "$case.answer"
    fi
    good=1
    cmp -s "$case.answer" "$case.got" || good=0
    [ "$code" = "$(cat "$case.code")" ] || good=0
    if [ "$code" = 2 ]; then
        wrong=$((wrong + 1))
        [ -s "$case.out" ] && good=0
        [ "$(wc -l < "$case.err")" -eq 1 ] || good=0
        [ "$(find "$work/here" | sort)" = "$before" ] || { echo "it wrote something: $words"; good=0; }
    fi
    before=$(find "$work/here" | sort)
    if [ $good = 1 ]; then
        passed=$((passed + 1))
    else
        failed=$((failed + 1))
        echo "FAILED: $words"
        diff "$case.answer" "$case.got" || true
        echo "exit code $code, expected $(cat "$case.code")"
    fi
done
# What a page without blocks would pass.
[ "$wrong" -ge 13 ] || { echo "FAILED: got $wrong wrong command lines, expected 13 or more"; exit 1; }
echo "$passed passed, $failed failed, $wrong of them wrong command lines"
[ "$failed" -eq 0 ]
