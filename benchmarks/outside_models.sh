#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# outside_models.sh OUT...: renders of `rye evaluate` and `rye compare` judged by models that nobody
# trained here: landmarks and identity by npm's @vladmandic/face-api, irises by @mediapipe/face_mesh,
# in a headless Chromium. OUT is a folder under which there are evaluate_SPLIT folders. What is not
# installed is named in a line that begins with "not run: ". The models have licences of their own.
#   MODULES    the node_modules folder (default: node_modules of this folder). To make it:
#              npm install --ignore-scripts @vladmandic/face-api@1.7.15 @mediapipe/face_mesh@0.4.1633559619
#   CHROMIUM   the browser (default: chromium, chromium-browser or google-chrome)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
[ $# -ge 1 ] || { echo "outside_models.sh: expected folders of rye evaluate or rye compare" >&2; exit 2; }
modules=${MODULES:-node_modules}
command -v node > /dev/null || { echo "not run: landmarks, identity, irises: no node (Debian package nodejs)"; exit 0; }
chromium=${CHROMIUM:-}
for name in chromium chromium-browser google-chrome; do
    [ -n "$chromium" ] || chromium=$(command -v "$name" || true)
done
[ -n "$chromium" ] || { echo "not run: landmarks, identity, irises: no chromium (Debian package chromium)"; exit 0; }
folders=$(find "$@" -type d -name 'evaluate_*' | sort)
[ -n "$folders" ] || { echo "outside_models.sh: no evaluate_SPLIT folder in $*" >&2; exit 2; }
# Folders here hold no spaces.
# shellcheck disable=SC2086
exec node "$here/outside_models.js" "$chromium" "$modules" $folders
