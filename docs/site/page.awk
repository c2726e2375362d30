# SPDX-License-Identifier: Apache-2.0
# page.awk -v id=NAME -v folder=FOLDER -v linked=FILE: a page of the project, Markdown for GitHub, as
# Doxygen reads it. Headings get labels (NAME__SLUG), links the addresses of the site's pages, code
# without a language is not highlighted, and characters that Doxygen takes for commands are escaped.
# Files of the project that no page of the site shows are listed in FILE.
function slug(text) {
    text = tolower(text)
    gsub(/\]\([^)]*\)/, "", text)  # a link's address
    gsub(/[^a-z0-9 _-]/, "", text)
    gsub(/ /, "-", text)
    if (used[text]++) text = text "-" (used[text] - 1)
    return text
}
function normal(path,    part, n, i, out, depth) {  # without . and ..
    n = split(path, part, "/"); depth = 0
    for (i = 1; i <= n; ++i) {
        if (part[i] == "." || part[i] == "") continue
        if (part[i] == "..") { if (depth > 0) --depth; continue }
        out[++depth] = part[i]
    }
    path = ""
    for (i = 1; i <= depth; ++i) path = path (i > 1 ? "/" : "") out[i]
    return path
}
function address(target,    anchor, at, name) {
    if (target ~ /^[a-z]+:/) return target
    at = index(target, "#"); anchor = ""
    if (at) { anchor = substr(target, at + 1); target = substr(target, 1, at - 1) }
    if (target == "") name = id
    else {
        target = normal((folder == "." ? "" : folder "/") target)
        if (target == "README.md") name = "index"
        else if (target == "CONTRIBUTING.md") name = "contributing"
        else if (target == "CHANGELOG.md") name = "changelog"
        else if (target == "docs/results") name = "results"
        else if (target == "examples") name = "lessons"
        else if (target ~ /^docs\/results\/.*\.md$/) { sub(/^docs\/results\//, "results_", target); sub(/\.md$/, "", target); name = target }
        else if (target ~ /^docs\/[^\/]*\.md$/) { sub(/^docs\//, "", target); sub(/\.md$/, "", target); name = target }
        else if (target ~ /^docs\/images\//) { sub(/^docs\//, "", target); return target }
        else { print target >> linked; return "files/" target ".txt" }
    }
    return name ".html" (anchor == "" ? "" : "#" name "__" anchor)
}
function links(text,    out, rest) {  # of a line
    out = ""
    while (match(text, /\]\([^)]*\)/)) {
        rest = substr(text, RSTART + 2, RLENGTH - 3)
        out = out substr(text, 1, RSTART + 1) address(rest) ")"
        text = substr(text, RSTART + RLENGTH)
    }
    return out text
}
function escaped(text,    part, n, i) {  # outside of `code`
    n = split(text, part, "`")
    for (i = 1; i <= n; i += 2) {
        gsub(/\\/, "\\\\", part[i]); gsub(/</, "\\&lt;", part[i]); gsub(/@/, "\\\\@", part[i])
        gsub(/ #/, " \\#", part[i])
    }
    text = part[1]
    for (i = 2; i <= n; ++i) text = text "`" part[i]
    return text
}
/^```/ {
    fenced = !fenced
    if (fenced) print ($0 == "```cpp" || $0 == "```c") ? "```{.cpp}" : "```{.unparsed}"
    else print "```"
    next
}
fenced { print; next }
/^<!--/ { next }
/^#+ / {
    level = $1; text = $0; sub(/^#+ +/, "", text)
    label = id (level == "#" ? "" : "__" slug(text))
    print level " " escaped(text) (label == "index" ? "" : " {#" label "}")
    next
}
/^!\[.*\]\(.*\)$/ {
    alt = $0; sub(/^!\[/, "", alt); sub(/\]\(.*/, "", alt)
    target = $0; sub(/^.*\]\(/, "", target); sub(/\)$/, "", target)
    print "<img src=\"" address(target) "\" alt=\"" alt "\"/>"
    next
}
/^<img src="/ {  # one with a width
    split($0, part, "\"")
    sub(/src="[^"]*"/, "src=\"" address(part[2]) "\"")
    print
    next
}
{ print links(escaped($0)) }
