#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# release.sh SOURCE WORK: the steps of packaging/release.sh that take seconds, and which program its
# launcher starts on which processor. Ends with 77 where SOURCE is no checkout of git.
set -eu
source=$1 work=$2
git -C "$source" rev-parse HEAD > /dev/null 2>&1 ||
    { echo "not run: release, for this is no checkout of git"; exit 77; }
rm -rf "$work"
mkdir -p "$work"
fail() { echo "FAILED: $*" >&2; exit 1; }
release() { STEPS="source container page licences checksums" HEAD='' sh "$source/packaging/release.sh" "$@"; }

release HEAD "$work/out" > "$work/said.txt" || { cat "$work/said.txt"; fail "release.sh"; }
grep -q '^not made: page: HEAD names no avatar file' "$work/said.txt" || fail "a page of nothing is not named"
(cd "$work/out" && sha256sum --check --quiet SHA256SUMS) || fail "the checksums are not of the files"
[ "$(wc -l < "$work/out/SHA256SUMS")" -ge 3 ] || fail "too few checksums"
cmp "$source/packaging/Containerfile" "$work/out/Containerfile" || fail "another container file"
cmp "$source/LICENSE" "$work/out/licences/rye" || fail "another licence"
tar -tzf "$work/out"/rye-*.tar.gz > "$work/names.txt"
grep -q '/include/rye/rye.hpp$' "$work/names.txt" || fail "the source has no headers"
release HEAD "$work/again" > "$work/said.txt"
cmp "$work/out/SHA256SUMS" "$work/again/SHA256SUMS" || fail "the same commit gives other bytes"
# Refused: a tag that is none, and a folder that is there.
! release no_such_tag "$work/none" 2> "$work/said.txt" || fail "a tag that is none"
grep -q "no tag or commit 'no_such_tag'" "$work/said.txt" || fail "no word of the tag"
! release HEAD "$work/out" 2> "$work/said.txt" || fail "a folder that is there"
grep -q 'is there already' "$work/said.txt" || fail "no word of the folder"

# The launcher.
mkdir "$work/programs"
cp "$source/packaging/launcher.sh" "$work/programs/rye"
for level in x86-64 x86-64-v3 x86-64-v4; do
    printf '#!/bin/sh\necho %s "$@"\n' $level > "$work/programs/rye-$level"
    chmod +x "$work/programs/rye-$level"
done
starts() { # FLAGS LEVEL
    printf 'model name\t: any\nflags\t\t: %s\n' "$1" > "$work/cpuinfo"
    said=$(RYE_CPUINFO="$work/cpuinfo" sh "$work/programs/rye" one "two words")
    [ "$said" = "$2 one two words" ] || fail "with '$1' it starts $said, not $2"
}
v3="fpu avx avx2 bmi1 bmi2 f16c fma abm movbe"
v4="$v3 avx512f avx512bw avx512cd avx512dq avx512vl"
starts "fpu sse2" x86-64
starts "$v3" x86-64-v3
starts "fpu avx avx2 bmi1 bmi2 f16c abm movbe" x86-64  # no fma
starts "$v4" x86-64-v4
rm "$work/programs/rye-x86-64-v4"
starts "$v4" x86-64-v3
said=$(RYE_LEVEL=x86-64 sh "$work/programs/rye" x)
[ "$said" = "x86-64 x" ] || fail "RYE_LEVEL is not obeyed: $said"
echo "the source, licences and checksums of a release, twice with the same bytes; the launcher starts the level that is there"
