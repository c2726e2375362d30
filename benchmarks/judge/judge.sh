#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# judge.sh OUT...: pictures of `rye evaluate` and `rye compare` judged by models that nobody trained
# here, in a headless Chromium: landmarks, irises, gaze by irises, eyeBlink and 52 coefficients by
# MediaPipe's face landmarker, identity by npm's @vladmandic/face-api. OUT is a folder under which there
# are evaluations (results.json beside evaluate_SPLIT). Prints a table, and writes judge.json into each
# evaluation that has none, which `rye compare`, wrong_labels.py, ladder.sh and figures.sh put into their tables.
# judge.sh --photographs CAPTURE: what the judge itself knows of gaze: its error on the photographs of a
# capture with labels.
# What is not installed is named in a line that begins with "not run: ". The models have licences of
# their own. From the environment:
#   FACE_LANDMARKER   the path of face_landmarker.task (MediaPipe's models page has it)
#   MODULES           the node_modules folder (default: node_modules of this folder). To make it:
#                     npm install --ignore-scripts @mediapipe/tasks-vision@1.1.0 @vladmandic/face-api@1.7.15
#   CHROMIUM          the browser (default: chromium, chromium-browser or google-chrome)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
wrong() { echo "judge.sh: $1" >&2; exit 2; }
[ $# -ge 1 ] || wrong "expected folders of rye evaluate or rye compare, or --photographs CAPTURE"
not_run() { echo "not run: the judge: $1"; exit 0; }
folders=
if [ "$1" = --photographs ]; then
    [ $# -eq 2 ] || wrong "--photographs: expected the folder of a capture"
    [ -e "$2/capture.json" ] || wrong "no capture.json in $2"
else
    # Folders here hold no spaces.
    for file in $(find "$@" -name results.json | sort); do
        folder=$(dirname "$file")
        for pictures in "$folder"/evaluate_*; do
            [ ! -d "$pictures" ] || [ ! -e "$folder/per_view.json" ] || { folders="$folders $folder"; break; }
        done
    done
    [ -n "$folders" ] || wrong "no results.json beside evaluate_SPLIT in $*"
fi
command -v node > /dev/null || not_run "no node (Debian package nodejs)"
CHROMIUM=${CHROMIUM:-}
for name in chromium chromium-browser google-chrome; do
    [ -n "$CHROMIUM" ] || CHROMIUM=$(command -v "$name" || true)
done
[ -n "$CHROMIUM" ] || not_run "no chromium (Debian package chromium)"
MODULES=${MODULES:-node_modules}
FACE_LANDMARKER=${FACE_LANDMARKER:-}
export CHROMIUM MODULES FACE_LANDMARKER
[ "$1" != --photographs ] || exec node "$here/photographs.js" "$2"
# shellcheck disable=SC2086
exec node "$here/evaluations.js" $folders
