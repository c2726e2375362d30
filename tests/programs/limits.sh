#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# limits.sh RYE WORK: a training where the system starts few threads, has little address space or
# gives threads the 128 kB of stack that musl does. It ends, with the bits of one without limits, or
# with a message; it never waits for threads that are not there.
set -eu
rye=$1
work=$2
rm -rf "$work"
mkdir -p "$work"
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }

"$rye" capture --out cap --size 64 --cameras 4 --frames 4 --test-frames 1 --apart-frames 0 \
    --samples 1 --quiet
# The upsampler as the preset has it, for its products are Eigen's.
cat > small.json << 'EOF'
{"avatar": {"networks": {"geometry": [16, 16], "exp_color": [16], "pose_color": [8],
    "exp_deform": [16, 16], "pose_deform": [8], "exp_attributes": [8], "pose_attributes": [8],
    "gaze_deform": [8], "gaze_color": [8], "eye_offset": [8]}},
 "grid": {"cell": 0.35},
 "mesh": {"steps": 3, "image_size": 32, "pretrain_steps": 5},
 "gaussians": {"steps": 2, "mouth_points": 20, "eyeball": {"points": 120}}}
EOF
# train OUT THREADS [COMMAND...]: COMMAND runs the training under a limit.
train() {
    out=$1 threads=$2
    shift 2
    timeout 200 "$@" "$rye" train --capture cap --preset tiny --config small.json --device cpu \
        --quiet --out "$out" --threads "$threads" > "$out.txt" 2>&1
}
same() { cmp free/checkpoint.safetensors "$1/checkpoint.safetensors" || fail "$1 has other bits"; }

train free 2 || { cat free.txt; fail "a training without limits"; }

( ulimit -S -s 128 && train stack 2 ) || { cat stack.txt; fail "a stack of 128 kB"; }
same stack

# Address space for some of 300 stacks of 8 MB.
if ( ulimit -s 8192 && ulimit -v 1048576 && train memory 300 ); then
    grep -q "started [0-9]* of 300 threads" memory.txt || { cat memory.txt; fail "no warning"; }
    same memory
elif [ $? = 2 ]; then
    grep -q "memory" memory.txt || { cat memory.txt; fail "no message about memory"; }
else
    cat memory.txt
    fail "1 GiB of address space"
fi

# Few threads for a user; root has no such limit, so another user runs it.
if [ "$(id -u)" != 0 ]; then limited="prlimit --nproc=$(($(ps -u "$(id -u)" -L | wc -l) + 5))"
else limited="prlimit --nproc=8 setpriv --reuid=65534 --regid=65534 --clear-groups"; fi
chmod 777 .
# shellcheck disable=SC2086 # several words
if $limited true 2> /dev/null && $limited ls "$rye" . > /dev/null 2>&1; then
    train few 64 $limited || { cat few.txt; fail "few threads"; }
    grep -q "started [0-9]* of 64 threads" few.txt || { cat few.txt; fail "no warning"; }
    same few
else
    echo "not run: a user with few threads (no prlimit or setpriv here, or $rye is not theirs to run)"
fi
echo "a training under limits of threads, address space and stack has the bits of one without"
