#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# crash_safety.sh RYE WORK: trainings that are killed, and disks that are full.
# A run is killed by signal 9 at KILLS random moments (3 unless the environment says otherwise), each
# time anew, and gone on with: its checkpoint must be that of the run that nobody stopped, byte for
# byte. Then what a run writes is refused by the system in several ways: there must be one clear
# sentence, and the checkpoint before must stay. Prints a table of both. What this machine cannot do
# is a line that begins with "skipped".
set -eu
rye=$1
work=$2
kills=${KILLS:-3}
seed=${SEED:-$$}
rm -rf "$work"
mkdir -p "$work"
cd "$work"
work=$(pwd)

bad=0
fail() { echo "FAILED: $*" >&2; exit 1; }
now() { date +%s%N; }
# The word of a key in a checkpoint's header.
word() { head -c 65536 "$1" | grep -a -o "\"$2\":\"[a-z0-9]*\"" | head -n 1 | cut -d '"' -f 4; }
leftovers() { find "$1" -name '*.tmp-*' | wc -l; }

"$rye" capture --out cap --size 50 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
cat > small.json << 'EOF'
{"avatar": {"feature": 8, "channels": 8,
  "networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8], "exp_deform": [16, 16],
    "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8], "gaze_deform": [8],
    "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 15, "image_size": 32, "pretrain_steps": 60, "fit_steps": 40},
 "gaussians": {"steps": 30, "mouth_points": 20, "panel_every": 7, "checkpoint_every": 3,
  "spacing": 0, "eyeball": {"points": 120}, "upsampler": {"capacity": 2, "doublings": 2},
  "weights": {"face_smooth": 1, "face_mirror": 0.5}}}
EOF
begin() { "$rye" train --capture cap --preset tiny --config small.json --quiet "$@"; }

start=$(now)
begin --out whole > whole.txt || { cat whole.txt; fail "the run that nobody stops"; }
length=$((($(now) - start) / 1000000))
# 50 pixels are no multiple of the upsampler's 4, nor of the 1 in 32 of stage 1: any size trains.
"$rye" redirect --run whole --out look.png > look.txt || fail "a picture of 50 x 50 pixels"

echo "a run of $length ms, killed (SEED=$seed)"
echo "kill  after ms  checkpoint left  temporary files  resumed  same bytes  files left over"
k=0
while [ $k -lt "$kills" ]; do
    k=$((k + 1))
    after=$(awk -v s="$seed" -v k=$k -v n="$length" 'BEGIN { srand(s); while (k-- >= 0) x = rand(); print int(x * n) }')
    rm -rf cut
    # No function here: its shell would be killed, and the program go on.
    "$rye" train --capture cap --preset tiny --config small.json --quiet --out cut > log.txt 2>&1 &
    pid=$!
    sleep "$(awk -v a="$after" 'BEGIN { printf "%.3f", a / 1000 }')"
    kill -9 "$pid" 2> /dev/null || true
    wait "$pid" 2> /dev/null || true
    left=none
    temporary=0
    [ -d cut ] && temporary=$(leftovers cut)
    if [ -e cut/checkpoint.safetensors ]; then
        left="$(word cut/checkpoint.safetensors stage) $(word cut/checkpoint.safetensors step)"
        how=yes
        "$rye" train --out cut --resume --quiet > log.txt 2>&1 || { cat log.txt; how=FAILED; }
    else
        how=anew
        begin --out cut > log.txt 2>&1 || { cat log.txt; how=FAILED; }
    fi
    same=no
    cmp -s whole/checkpoint.safetensors cut/checkpoint.safetensors && same=yes
    grep -c . whole/log.jsonl > lines.txt
    [ "$(cat lines.txt)" -eq "$(grep -c . cut/log.jsonl)" ] || same="yes, not its log"
    cmp -s whole/config.json cut/config.json || same="yes, not its config"
    over=$(leftovers cut)
    printf '%4d  %8d  %-15s  %15d  %-7s  %-10s  %15d\n' $k "$after" "$left" "$temporary" "$how" \
        "$same" "$over"
    [ "$same" = yes ] && [ "$over" -eq 0 ] && [ "$how" != FAILED ] || bad=1
done

# ---- what the system refuses ---------------------------------------------------------------------
echo
echo "what is refused                code  checkpoint of before  message"
# row NAME EXPECTED COMMAND...: the command must fail (or not, for the words "a warning") with a
# line that holds the words, and $run/checkpoint.safetensors must be as in kept.bin, if that is there.
row() {
    name=$1
    words=$2
    shift 2
    code=0
    "$@" > out.txt 2> err.txt || code=$?
    verdict=
    case $words in
        warning*) [ $code -eq 0 ] || verdict="FAILED: it ended" ;;
        *) { [ $code -ne 0 ] && [ $code -lt 126 ]; } || verdict="FAILED: code $code" ;;
    esac
    grep -q -- "$words" err.txt || verdict="FAILED: no word of '$words'"
    intact=none
    if [ -e kept.bin ]; then
        intact=same
        cmp -s kept.bin "$run/checkpoint.safetensors" || { intact=other; verdict="FAILED: lost"; }
    fi
    sed "s#$work/##g" err.txt | head -n 1 > line.txt
    printf '%-30s  %3d  %-20s  %s%s\n' "$name" $code "$intact" "$(cut -c1-150 line.txt)" \
        "${verdict:+ $verdict}"
    [ -z "$verdict" ] || { cat err.txt; bad=1; }
}
skip() { printf 'skipped: %s: %s\n' "$1" "$2"; }
step_of() { word "$1/checkpoint.safetensors" step; }

# A limit on the size of files stands for a full disk wherever one has no disk to fill: 512-byte
# blocks, enough for config.json and log.jsonl, fewer than any checkpoint has.
blocks=40
cp -r whole limited
run=limited
cp limited/checkpoint.safetensors kept.bin
row "files limited, more steps" "checkpoint.safetensors: cannot be written.*File too large" \
    sh -c "ulimit -f $blocks; exec '$rye' train --out limited --resume --steps 33 --quiet"
cp limited/log.jsonl kept.jsonl
row "files limited, --overwrite" "the run that is there stays as it was" \
    sh -c "ulimit -f $blocks; exec '$rye' train --capture cap --preset tiny --config small.json \
           --quiet --out limited --overwrite"
cmp -s kept.jsonl limited/log.jsonl || { echo "FAILED: the old log is lost"; bad=1; }
rm kept.bin
run=fresh
row "files limited, new run" "there is no checkpoint before it" \
    sh -c "ulimit -f $blocks; exec '$rye' train --capture cap --preset tiny --config small.json \
           --quiet --out fresh"
row "--out is a file" "small.json: is a file, expected a folder" begin --out small.json
mkdir -p taken/checkpoint.safetensors
row "the checkpoint is a folder" "is a folder" begin --out taken --overwrite
[ ! -e taken/config.json ] || { echo "FAILED: a run was begun where it cannot be saved"; bad=1; }

# As a user without rights: root may write anywhere.
run=closed
cp -r whole closed
chmod a-w closed closed/panels
cp whole/checkpoint.safetensors kept.bin
if [ "$(id -u)" -ne 0 ]; then
    row "a folder without rights" "Permission denied" "$rye" train --out closed --resume --steps 33 --quiet
elif setpriv --reuid 65534 --regid 65534 --clear-groups test -x "$rye" -a -r cap/capture.json \
        2> /dev/null; then
    row "a folder without rights" "Permission denied" setpriv --reuid 65534 --regid 65534 \
        --clear-groups "$rye" train --out closed --resume --steps 33 --quiet
else
    skip "a folder without rights" "root may write anywhere, and another user cannot come here"
fi
chmod u+w closed closed/panels
rm kept.bin

# A disk of its own, to fill.
mkdir disk
if mount -t tmpfs -o size=4m tmpfs disk 2> mount.txt; then
    trap 'umount "$work/disk" 2> /dev/null || true' EXIT
    cp -r whole disk/run
    run=disk/run
    cp whole/checkpoint.safetensors kept.bin
    head -c 8m /dev/zero > disk/filler 2> /dev/null || true
    row "full disk, resumed" "cannot be written.*No space left on device" \
        "$rye" train --out disk/run --resume --steps 33 --quiet
    [ "$(leftovers disk/run)" -eq 0 ] || { echo "FAILED: files left over"; bad=1; }
    cmp -s whole/log.jsonl disk/run/log.jsonl || { echo "FAILED: the log is lost or half"; bad=1; }
    # Room for config.json and log.jsonl, not for the next checkpoint.
    head -c 8m /dev/zero > disk/filler 2> /dev/null || true
    truncate -s -65536 disk/filler
    row "full disk, at the checkpoint" "cannot be written.*No space left on device" \
        "$rye" train --out disk/run --resume --steps 33 --quiet
    row "full disk, --overwrite" "the run that is there stays as it was" begin --out disk/run --overwrite
    rm -f disk/filler
    rm kept.bin
    "$rye" train --out disk/run --resume --steps 33 --quiet > log.txt 2>&1 ||
        { cat log.txt; echo "FAILED: it does not go on"; bad=1; }
    [ "$(step_of disk/run)" = 33 ] || { echo "FAILED: it did not reach its end"; bad=1; }
    # Log and panels alone cannot be written: a warning, and the run goes on. Its checkpoints are on
    # another disk, through a link.
    mkdir panels other
    rm -rf disk/run
    cp -r whole other/run
    rm -rf other/run/panels
    mkdir disk/panels
    ln -s "$work/disk/panels" other/run/panels
    head -c 8m /dev/zero > disk/filler 2> /dev/null || true
    run=other/run
    row "full disk under the panels" "warning: .*panels.*No space left on device" \
        "$rye" train --out other/run --resume --steps 33 --quiet
    [ "$(find disk/panels -name '*.png' | wc -l)" -eq 0 ] || { echo "FAILED: half a panel"; bad=1; }
    umount disk
else
    skip "full disk (a tmpfs)" "$(tail -n 1 mount.txt)"
fi

[ $bad -eq 0 ] || fail "see the tables"
echo "1 passed, 0 failed"
