#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# first_head.sh ARCHIVE WORK: what one does in the first minutes with the programs of a release: unpacks
# ARCHIVE in the new folder WORK, makes a capture, trains an avatar, draws a sheet of its gazes and four
# seconds of a face that moves. Needs no more than a minimal system. The last line has seconds, with
# commas: unpack, capture, train, sheet, moving picture; then MB:
# of the archive, unpacked, and of what was made; and the bytes of the picture that moves.
set -eu
archive=$(readlink -f "$1")
[ ! -e "$2" ] || { echo "first_head.sh: $2 is there already" >&2; exit 2; }
mkdir -p "$2"
cd "$2"
times=
timed() { # COMMAND...
    begin=$(date +%s%N)
    "$@"
    times="$times$(awk -v a="$begin" -v b="$(date +%s%N)" 'BEGIN { printf "%.1f", (b - a) / 1e9 }'),"
}
megabytes() { du -sk --apparent-size "$@" | awk '{ sum += $1 } END { printf "%.1f", sum * 1024 / 1e6 }'; }
mkdir programs
timed tar -xzf "$archive" -C programs --strip-components=1
rye=programs/rye
$rye --version
timed $rye capture --out capture
timed $rye train --capture capture --preset tiny --out run
timed $rye redirect --run run --sweep --out sweep.png
timed $rye redirect --run run --idle 4 --out live.apng
grep -aq acTL live.apng || { echo "first_head.sh: live.apng does not move" >&2; exit 1; }
echo "$times$(megabytes "$archive"),$(megabytes programs),$(megabytes capture run sweep.png live.apng),$(wc -c < live.apng)"
