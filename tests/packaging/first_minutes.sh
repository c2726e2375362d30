#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# first_minutes.sh RELEASE WORK [SUITE...]: how long it takes from the published programs to the first
# face whose eyes move (first_head.sh), on bare systems: Debian 11, 12, 13, Ubuntu 22.04, 24.04. RELEASE is
# a folder that packaging/release.sh made, with programs for x86-64; WORK is for the systems. Prints
# a row of a table for each, and then which could not be had, and why.
set -eu
[ $# -ge 2 ] || { echo "first_minutes.sh: expected RELEASE WORK [SUITE...]" >&2; exit 2; }
here=$(cd "$(dirname "$0")/.." && pwd)
archive=$(find "$1" -maxdepth 1 -name 'rye-*-linux-x86_64.tar.gz')
[ -f "$archive" ] || { echo "first_minutes.sh: no rye-VERSION-linux-x86_64.tar.gz in $1" >&2; exit 2; }
mkdir -p "$2"
work=$(cd "$2" && pwd)
shift 2
[ $# -gt 0 ] || set -- bullseye bookworm trixie jammy noble
: > "$work/skipped"
failed=0
echo "| system | unpack | capture | train | sheet of gazes | 4 s that move | together | archive | unpacked | made | moving picture |"
echo "|---|---|---|---|---|---|---|---|---|---|---|"
for suite; do
    status=0
    # shellcheck disable=SC2016 # for the shell in there
    BUILD=$work CARRY=$archive sh "$here/bare.sh" "$suite" sh -c \
        '. /etc/os-release && echo "$PRETTY_NAME" && sh tests/packaging/first_head.sh carried/* first' \
        > "$work/$suite.minutes" 2>&1 || status=$?
    if [ $status = 77 ]; then
        echo "not run: first minutes on $suite: $(tail -n 1 "$work/$suite.minutes")" >> "$work/skipped"
    elif [ $status != 0 ]; then
        tail -n 5 "$work/$suite.minutes"
        failed=1
    else
        { head -n 1 "$work/$suite.minutes"; tail -n 1 "$work/$suite.minutes"; } | paste -sd , |
            awk -F, '{ printf "| %s | %s s | %s s | %s s | %s s | %s s | %.0f s | %s MB | %s MB | %s MB | %.1f MB |\n",
                $1, $2, $3, $4, $5, $6, $2 + $3 + $4 + $5 + $6, $7, $8, $9, $10 / 1e6 }'
    fi
done
cat "$work/skipped"
exit $failed
