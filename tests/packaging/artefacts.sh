#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# artefacts.sh RELEASE WORK: RELEASE, a folder that packaging/release.sh made, as those who download it
# have it: checksums; the program for aarch64 by qemu-user, which makes a capture and trains a few steps; the
# Debian packages on bare systems; the page, opened from a disk. What is not there, or cannot run here, is named.
set -eu
[ $# -eq 2 ] || { echo "artefacts.sh: expected two arguments, RELEASE WORK" >&2; exit 2; }
here=$(cd "$(dirname "$0")/../.." && pwd)
mkdir -p "$2"
release=$(cd "$1" && pwd) work=$(cd "$2" && pwd)
fail() { echo "FAILED: $*" >&2; exit 1; }
not_run() { echo "not run: artefacts, $1"; }
has() { command -v "$1" > /dev/null 2>&1; }
unpacked() { # KIND: the archive rye-VERSION-KIND.tar.gz in $work/KIND
    archive=$(find "$release" -maxdepth 1 -name "rye-*-$1.tar.gz")
    [ -f "$archive" ] || { not_run "$1: there is no such archive"; return 1; }
    rm -rf "${work:?}/$1"
    mkdir "$work/$1"
    tar -xzf "$archive" -C "$work/$1" --strip-components=1
}
# A capture and a few steps of training by the command RYE..., the same for one thread and for two.
few_steps() { # FOLDER RYE...
    rm -rf "$1"
    mkdir "$1"
    (cd "$1"
        shift
        "$@" capture --out cap --size 32 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 --samples 1 --quiet
        for threads in 1 2; do
            "$@" train --capture cap --preset tiny --config "$here/tests/portability/small.json" --quiet \
                --out "run$threads" --threads "$threads"
        done
        cmp run1/checkpoint.safetensors run2/checkpoint.safetensors
        "$@" redirect --run run1 --sweep --out sweep.png)
}

(cd "$release" && sha256sum --check --quiet SHA256SUMS) || fail "checksums"
listed=$(wc -l < "$release/SHA256SUMS") found=$(find "$release" -type f ! -name SHA256SUMS | wc -l)
[ "$listed" = "$found" ] || fail "SHA256SUMS lists $listed files of $found"
echo "checksums: of $found files"

if unpacked linux-x86_64; then
    few_steps "$work/x86_64" "$work/linux-x86_64/rye"
    echo "x86_64: $("$work/linux-x86_64/rye" --version), a capture and a few steps"
fi
if unpacked linux-aarch64; then
    if has qemu-aarch64; then
        few_steps "$work/aarch64" qemu-aarch64 "$work/linux-aarch64/rye"
        echo "aarch64: $(qemu-aarch64 "$work/linux-aarch64/rye" --version), a capture and a few steps by qemu-user"
    else
        not_run "aarch64: no qemu-aarch64 (Debian package qemu-user)"
    fi
fi

package=$(find "$release" -maxdepth 1 -name 'rye_*_amd64.deb')
if [ -f "$package" ]; then
    for suite in bookworm trixie; do
        status=0
        # shellcheck disable=SC2016 # for the shell in there
        BUILD=$work CARRY=$package sh "$here/tests/bare.sh" "$suite" sh -c '
            dpkg -i carried/*.deb && rye --version &&
            rye capture --out cap --size 64 --cameras 3 --frames 3 --test-frames 1 --apart-frames 0 \
                --samples 1 --quiet && rye info --capture cap && [ -f /usr/share/man/man1/rye.1 ] &&
            ls /usr/share/doc/rye/licences && dpkg -r rye && [ ! -e /usr/bin/rye ]' > "$work/$suite.deb.txt" 2>&1 || status=$?
        case $status in
        0) echo "$(basename "$package"): installed and run on $suite" ;;
        77) not_run "$(basename "$package") on $suite: $(tail -n 1 "$work/$suite.deb.txt")" ;;
        *) cat "$work/$suite.deb.txt"; fail "$(basename "$package") on $suite" ;;
        esac
    done
else
    not_run "the Debian package: there is none"
fi

if unpacked page; then
    chromium=${CHROMIUM:-}
    for name in chromium chromium-browser google-chrome; do
        [ -n "$chromium" ] || chromium=$(command -v "$name" || true)
    done
    if [ -n "$chromium" ] && has node; then
        node "$here/tests/gaze_page/from_disk.js" "$chromium" "$work/page" "$work/page.png" ||
            fail "the page, opened from a disk"
        echo "page: opened from a disk"
    else
        not_run "page: no chromium or no node (Debian packages chromium, nodejs)"
    fi
fi
