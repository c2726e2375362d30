#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# gaze_dots.sh RYE PAGE WORK: docs/gaze_dots.html in a browser, and its file as `rye` reads it. Where a
# browser or node is missing it says so and ends with 77. CHROMIUM: the browser (default: chromium,
# chromium-browser or google-chrome).
set -eu
rye=$1
page=$2
work=$3
not_run() { echo "skipped: gaze_dots: $1"; exit 77; }
chromium=${CHROMIUM:-}
for name in chromium chromium-browser google-chrome; do
    [ -n "$chromium" ] || chromium=$(command -v "$name" || true)
done
[ -n "$chromium" ] || not_run "no chromium (Debian package chromium)"
command -v node > /dev/null || not_run "no node (Debian package nodejs)"
rm -rf "$work"
mkdir -p "$work"
node "$(dirname "$0")/gaze_dots.js" "$chromium" "$page" "$work/dots.csv"
film() { "$rye" capture --video "$work/head.y4m" --frames 4 --rate 1 --size 64 --samples 1 --quiet "$@"; }
film --dots "$work/dots.csv" --out "$work/looks"
rm "$work/head.y4m"
film --out "$work/around"
cmp -s "$work/looks/params/0002/gaze.npz" "$work/around/params/0002/gaze.npz" &&
    { echo "the eyes of a film do not follow its dots"; exit 1; }
sed 's/right_mm/left_mm/' "$work/dots.csv" > "$work/wrong.csv"
rm "$work/head.y4m"
said=$(film --dots "$work/wrong.csv" --out "$work/wrong" 2>&1) && { echo "a wrong file was taken"; exit 1; }
case $said in
    *"wrong.csv: line 1: got 'begin_s,end_s,left_mm,up_mm', expected"*) ;;
    *) echo "$said"; exit 1 ;;
esac
[ ! -e "$work/wrong" ]
echo "the eyes of a film follow the dots of the page"
