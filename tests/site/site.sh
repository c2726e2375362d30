#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# site.sh SOURCE WORK: makes the site (docs/site/site.sh, which checks its links) and has a headless
# Chromium visit it (visit.js). Where doxygen is missing it says so and ends with 77; where node or
# Chromium is, the visit is named as not run. CHROMIUM of the environment names the browser.
set -eu
source=$1 work=$2
command -v doxygen > /dev/null || { echo "not run: site, for there is no doxygen"; exit 77; }
mkdir -p "$work"
sh "$source/docs/site/site.sh" "$source" "$work/site"
# A link to what is not there is found.
printf '<a href="gone.html">gone</a>\n' >> "$work/site/gallery.html"
! sh "$source/docs/site/links.sh" "$work/site" > "$work/said.txt" || { echo "links.sh finds no broken link"; exit 1; }
grep -q 'gallery.html: no such file: gone.html' "$work/said.txt" || { cat "$work/said.txt"; exit 1; }
sed -i '$d' "$work/site/gallery.html"
chromium=${CHROMIUM:-}
for name in chromium chromium-browser google-chrome; do
    [ -n "$chromium" ] || chromium=$(command -v "$name" || true)
done
if [ -z "$chromium" ] || ! command -v node > /dev/null; then
    echo "not run: a visit to the site, for there is no node or no chromium"
    exit 0
fi
node "$source/tests/site/visit.js" "$chromium" "$work/site" "$work/pictures"
