#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# container.sh RELEASE WORK: builds the image of RELEASE/Containerfile, with the bare system of
# tests/bare.sh in place of the image that it begins with, and runs its entry point: --version, and a small capture
# into the folder /work. Needs podman and buildah; without them, or without a bare system, it says so and
# ends with 77. Their storage lies in WORK, of the kind STORAGE (overlay).
set -eu
[ $# -eq 2 ] || { echo "container.sh: expected two arguments, RELEASE WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$2"
release=$(cd "$1" && pwd) work=$(cd "$2" && pwd)
not_run() { echo "not run: container: $1"; exit 77; }
fail() { echo "FAILED: $*" >&2; exit 1; }
for tool in podman buildah; do
    command -v $tool > /dev/null || not_run "no $tool (Debian package $tool)"
done
BUILD=$work sh "$here/tests/bare.sh" trixie true > "$work/bare.txt" 2>&1 || not_run "$(tail -n 1 "$work/bare.txt")"
engine() { # TOOL ARGUMENTS...
    tool=$1
    shift
    "$tool" --root "$work/storage" --runroot "$work/running" --storage-driver "${STORAGE:-overlay}" "$@"
}
image=localhost/rye-release-test base=localhost/bare-trixie
engine podman image exists $base ||
    tar -C "$work/trixie.base" --exclude=./var/cache --exclude=./var/lib/apt -c . |
    engine podman import - $base > "$work/import.txt" 2>&1 ||
    not_run "podman imports no image: $(tail -n 1 "$work/import.txt")"
# Isolated by chroot alone, for machines that are containers themselves.
engine podman build --layers=false --isolation chroot --network host --build-arg BASE=$base -t $image "$release" \
    > "$work/build.txt" 2>&1 || { cat "$work/build.txt"; fail "podman build"; }
entry=$(engine podman image inspect --format '{{json .Config.Entrypoint}} {{.Config.WorkingDir}}' $image)
[ "$entry" = '["rye"] /work' ] || fail "the entry point is $entry"
small="--size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 --samples 1"
rm -rf "$work/made"
mkdir "$work/made"
# shellcheck disable=SC2086 # a list
if engine podman run --rm --network host -v "$work/made:/work" $image capture --out capture $small > "$work/run.txt" 2>&1; then
    by="podman run"
else
    echo "podman runs no container here: $(tail -n 1 "$work/run.txt")"
    by="buildah run"
    container=$(engine buildah from $image)
    engine buildah run --isolation chroot -v "$work/made:/work" "$container" -- rye capture --out capture $small
    engine buildah rm "$container" > /dev/null
fi
[ -n "$(ls "$work/made/capture")" ] || fail "no capture in the folder /work"
echo "container: $(engine podman image inspect --format '{{.Size}}' $image) bytes; a capture by $by"
