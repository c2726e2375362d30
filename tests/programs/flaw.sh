#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# flaw.sh RYE PAGE WORK: the command lines of the page, and one with everything, on a rendered
# capture: `rye info` accepts each copy, test frames keep their labels, the files that no error
# touches and those of one seed are the same byte by byte.
set -eu
rye=$1
page=$(cd "$(dirname "$2")" && pwd)/$(basename "$2")
work=$3
rm -rf "$work"
mkdir -p "$work"
cd "$work"
fail() { echo "FAILED: $*" >&2; exit 1; }
checks=0
# same A B: two files or folders; flaws.json, of which C has none, apart.
same() {
    checks=$((checks + 1))
    diff -r -q -x flaws.json "$1" "$2" > diff.txt || { cat diff.txt; fail "$1 and $2 differ"; }
}
usable() {
    checks=$((checks + 1))
    "$rye" info "$1" > info.txt 2>&1 || { cat info.txt; fail "rye info $1"; }
    grep -q 'as it was written' info.txt && { cat info.txt; fail "checksums of $1"; }
    [ -s "$1/flaws.json" ] || fail "$1 has no flaws.json"
    [ ! -e "$1.tmp" ] || fail "$1.tmp is left"
}

"$rye" capture --out C --size 48 --cameras 4 --frames 4 --test-frames 1 --apart-frames 1 \
    --samples 1 --quiet
tests=$(tr -d ' \n' < C/capture.json | sed 's/.*"test_frames":\[\([^]]*\)\].*/\1/' | tr -d '"' | tr ',' ' ')
[ "$(echo "$tests" | wc -w)" = 2 ] || fail "the test frames are $tests, expected two"
camera=01

grep '^rye flaw --capture C --out' "$page" | sed "s/NAME/$camera/; s/#.*//; s/^rye //" > lines.txt
[ "$(wc -l < lines.txt)" -ge 4 ] || fail "$page has $(wc -l < lines.txt) commands, expected 4 or more"
while read -r line; do
    # shellcheck disable=SC2086 # words of the page
    "$rye" $line --quiet || fail "$line"
    out=$(echo "$line" | sed 's/.*--out \([a-z]*\).*/\1/')
    usable "$out"
    for f in $tests; do same "C/params/$f" "$out/params/$f"; done
done < lines.txt
for folder in images cameras; do same C/$folder gaze/$folder; same C/$folder track/$folder; done
same C/params gains/params
same C/cameras gains/cameras
same C/params one/params
find one/cameras -name '*.npz' > cameras.txt
[ "$(grep -c "camera_$camera" cameras.txt)" = 6 ] || fail "frames of camera $camera are missing"
[ "$(wc -l < cameras.txt)" = 6 ] || fail "cameras beside $camera are left"

everything="--gaze-common 4 --gaze-single 2 --centres 1 --expression 0.06 --expression-share 0.5
    --pose 0.6,1 --landmarks 1.5 --camera-rotation 0.1 --camera-position 2 --focal 1 --gain 12
    --white-balance 5 --exposure 5 --vignetting 10 --soft-masks 1 --wrong-masks 1
    --eye-mask-dilation 1 --blur 0.7 --jpeg 75 --noise 2 --drop-views 0.2"
# shellcheck disable=SC2086
for run in "a --threads 1" "b --threads 3" "c --labels all --pictures train"; do
    "$rye" flaw --capture C --seed 5 $everything --quiet --out $run || fail "$run"
done
same a b
cmp a/flaws.json b/flaws.json
for out in a c; do usable $out; done
for f in $tests; do
    same "C/params/$f" "a/params/$f"
    same "C/cameras/$f" "a/cameras/$f"
    cmp -s "C/images/$f/mask_$camera.png" "c/images/$f/mask_$camera.png" && fail "masks of $f stayed"
    cmp -s "C/params/$f/gaze.npz" "c/params/$f/gaze.npz" && fail "gazes of $f stayed"
done
"$rye" flaw --capture C --out a --gain 1 2> said.txt && fail "an --out that is there was taken"
grep -q "rye flaw: --out: got 'a', which exists already" said.txt || { cat said.txt; fail "what it says"; }
echo "$checks passed, 0 failed"
