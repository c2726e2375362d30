#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# site.sh SOURCE OUT: the site as a folder OUT to publish by copying: the guide (README and docs), the
# lessons, the results, a gallery, what accuracy costs, and a page for each public name, by Doxygen. OUT is
# replaced; OUT.work holds what was made on the way. From the environment:
#   DOXYGEN     the program (default: doxygen)
#   GAZE_PAGE   a folder that examples/gaze_page/build.sh made, linked as "Live" (default:
#               SOURCE/build/gaze_page, where that exists)
set -eu
[ $# -eq 2 ] || { echo "site.sh: expected two arguments, SOURCE OUT" >&2; exit 2; }
source=$(cd "$1" && pwd) out=$2
tool=${DOXYGEN:-doxygen}
command -v "$tool" > /dev/null || { echo "site.sh: no doxygen; install it (Debian: doxygen)" >&2; exit 2; }
here=$source/docs/site
[ ! -e "$out" ] || [ -f "$out/doxygen.css" ] || { echo "site.sh: $out is there, and no site" >&2; exit 2; }
mkdir -p "$out.work"
work=$(cd "$out.work" && pwd)
rm -rf "$out" "${work:?}"/*
mkdir -p "$out/images" "$work/pages"
out=$(cd "$out" && pwd)
cd "$source"
version=$(sed -n 's/#define RYE_VERSION_[A-Z]* \([0-9]*\)/\1/p' include/rye/core/config.hpp | paste -sd .)

# ---- pages: Markdown as Doxygen reads it -----------------------------------------------------------
page() { # FILE NAME
    awk -v id="$2" -v folder="$(dirname "$1")" -v linked="$work/linked.txt" -f "$here/page.awk" "$1" \
        > "$work/pages/$2.md"
}
title() { sed -n '1s/^# *//p' "$1"; }
page README.md index
page CONTRIBUTING.md contributing
page CHANGELOG.md changelog
# In README's order, then what README does not name.
guide=$(grep -oE '\(docs/[a-z_]+\.md' README.md | sed 's/^(//' | awk '!seen[$0]++')
for file in $guide docs/*.md; do
    name=$(basename "$file" .md)
    [ -f "$work/pages/$name.md" ] || { page "$file" "$name"; echo "$name	$(title "$file")"; }
done > "$work/guide.txt"
for file in docs/results/*.md; do
    page "$file" "results_$(basename "$file" .md)"
    echo "results_$(basename "$file" .md)	$(title "$file")"
done > "$work/results.txt"
list() { awk -F '\t' '{ printf "- [%s](%s.html)\n", $2, $1 }' "$1"; }
{ printf '# Guide {#guide}\n\n'; list "$work/guide.txt"; } > "$work/pages/guide.md"
{ printf '# Results {#results}\n\nMeasured tables, each with the command that prints it.\n\n'
  list "$work/results.txt"; } > "$work/pages/results.md"
{
    printf '# Lessons {#lessons}\n\nEach is a program of one file in the folder examples, run by the tests.\n\n'
    for file in examples/[0-9]*; do
        name=$(basename "$file")
        about=$(sed -n 's/^[/* ]*Lesson [0-9]*: \([^.]*\)\..*/\1/p' "$file" | head -n 1)
        [ -n "$about" ] || { echo "site.sh: $file does not say what lesson it is" >&2; exit 1; }
        printf -- '- [%s](#lessons__%s): %s\n' "$name" "${name%.*}" "$about"
    done
    for file in examples/[0-9]*; do
        name=$(basename "$file")
        printf '\n## %s {#lessons__%s}\n\n```{.cpp}\n' "$name" "${name%.*}"
        cat "$file"
        printf '```\n'
    done
} > "$work/pages/lessons.md"
{
    printf '# Gallery {#gallery}\n\nEach picture links to the page that says how it was made.\n'
    for file in README.md docs/*.md docs/results/*.md; do
        case $file in
            docs/results/*) to=results_$(basename "$file" .md) ;;
            docs/*) to=$(basename "$file" .md) ;;
            *) to=index ;;
        esac
        sed -n 's|^!\[\(.*\)\](.*images/\(.*\))$|\2	\1|p
            s|^<img src=".*images/\([^"]*\)".*alt="\(.*\)">$|\1	\2|p' "$file" | awk -F '\t' -v to="$to" '
            !/svg/ { printf "\n<a href=\"%s.html\"><img src=\"images/%s\" alt=\"%s\"/></a>\n\n%s.\n", to, $1, $2, $2 }'
    done | awk '/<img/ { split($0, part, "src=\""); skip = seen[part[2]]++ } !skip'
} > "$work/pages/gallery.md"
awk -v script="$here/prices.js" -f "$here/prices.awk" docs/results/accuracy.md > "$work/pages/prices.md"
cp docs/images/* "$out/images/"
cp docs/gaze_dots.html "$out/"
# Files of the project that pages link to, as text.
[ ! -f "$work/linked.txt" ] || sort -u "$work/linked.txt" | while read -r file; do
    [ -f "$file" ] || { echo "site.sh: a page links to $file, which is no file" >&2; exit 1; }
    mkdir -p "$out/files/$(dirname "$file")"
    cp "$file" "$out/files/$file.txt"
done

# ---- the live page, if it was built ------------------------------------------------------------------
live=
gaze=${GAZE_PAGE:-build/gaze_page}
if [ -f "$gaze/rye.wasm" ]; then
    mkdir "$out/live"
    find "$gaze" -maxdepth 1 -type f -exec cp {} "$out/live/" \;
    live='<tab type="user" url="live/index.html" title="Live"/>'
else
    echo "site.sh: no live page, for there is none in $gaze (examples/gaze_page/build.sh makes it)"
fi

# ---- the menu ------------------------------------------------------------------------------------------
tabs() { awk -F '\t' '{ printf "<tab type=\"user\" url=\"%s.html\" title=\"%s\"/>\n", $1, $2 }' "$1"; }
cat > "$work/layout.xml" << XML
<doxygenlayout version="1.0">
<navindex>
<tab type="mainpage" title="Home"/>
<tab type="usergroup" url="guide.html" title="Guide">
$(tabs "$work/guide.txt")
<tab type="user" url="contributing.html" title="Contributing"/>
<tab type="user" url="changelog.html" title="Changes"/>
</tab>
<tab type="user" url="lessons.html" title="Lessons"/>
<tab type="usergroup" url="results.html" title="Results">
$(tabs "$work/results.txt")
</tab>
<tab type="user" url="gallery.html" title="Gallery"/>
<tab type="user" url="prices.html" title="Prices"/>
$live
<tab type="usergroup" url="annotated.html" title="Names">
<tab type="concepts" title="Concepts"/>
<tab type="classlist" title="Types"/>
<tab type="namespacemembers" title="Functions and constants"/>
<tab type="filelist" title="Headers"/>
</tab>
</navindex>
</doxygenlayout>
XML

# ---- Doxygen -----------------------------------------------------------------------------------------
sed "s|@SOURCE@|$source|; s|@WORK@|$work|; s|@VERSION@|$version|" "$here/Doxyfile.in" > "$work/Doxyfile"
cat >> "$work/Doxyfile" << END
INPUT                 += $work/pages
USE_MDFILE_AS_MAINPAGE = $work/pages/index.md
OUTPUT_DIRECTORY       = $work
GENERATE_HTML          = YES
HTML_OUTPUT            = $out
HTML_EXTRA_STYLESHEET  = $here/style.css
LAYOUT_FILE            = $work/layout.xml
WARN_IF_UNDOCUMENTED   = NO
# The first lines of a header are its description; pages that a comment names are links.
FILTER_PATTERNS        = "*.hpp=sed -E -f $here/header.sed"
SOURCE_BROWSER         = NO
VERBATIM_HEADERS       = NO
SEARCHENGINE           = YES
TOC_INCLUDE_HEADINGS   = 0
END
"$tool" "$work/Doxyfile" > "$work/said.txt" 2>&1 || { cat "$work/said.txt"; exit 1; }
if [ -s "$work/warnings.txt" ]; then
    sed "s|^$source/||" "$work/warnings.txt" | head -n 40
    echo "site.sh: Doxygen finds faults in the pages"
    exit 1
fi
# Doxygen 1.9.4 links a list of types that a class keeps to itself, and writes none.
grep -L 'name="nested-classes"' "$out"/class*.html "$out"/struct*.html |
    xargs sed -i 's|<a href="#nested-classes">Classes</a> &#124;||'
sh "$here/links.sh" "$out"
echo "the site: $out"
