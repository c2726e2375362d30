# SPDX-License-Identifier: Apache-2.0
# prices.awk -v script=FILE docs/results/accuracy.md: a page where a slider sets the largest error that one
# accepts, and the cheapest policy within it is shown: of the measured rows that have a time. Without
# scripts it is the table.
function cell(i) { text = $i; gsub(/^ +| +$/, "", text); return text }
BEGIN {
    FS = "|"
    print "# What accuracy costs {#prices}\n"
    print "Of the [measured policies](results_accuracy.html) in the worst of ten scenes: the cheapest whose largest"
    print "error is within what you accept. 1 is full scale; a step of an 8-bit picture is 0.0039. Times are"
    print "relative to Exact32.\n"
    print "\\htmlonly[block]"
    print "<div id=\"prices\">"
    print "<p><label>Of <select id=\"prices-of\"><option value=\"0\">pictures</option><option value=\"1\">gradients</option></select></label>"
    print "<label for=\"prices-bound\">accept an error of</label> <output id=\"prices-is\"></output></p>"
    print "<input id=\"prices-bound\" type=\"range\" min=\"-14\" max=\"0\" step=\"0.05\" value=\"-2.4\">"
    print "<p id=\"prices-says\" role=\"status\"></p>"
    print "<svg id=\"prices-chart\" viewBox=\"0 0 700 330\" role=\"img\" aria-label=\"Time against error, a point a policy\"></svg>"
    print "<table class=\"markdownTable\"><thead><tr><th class=\"markdownTableHeadNone\">policy or setting</th><th class=\"markdownTableHeadNone\">error of pictures</th><th class=\"markdownTableHeadNone\">of gradients</th><th class=\"markdownTableHeadNone\">time, picture</th><th class=\"markdownTableHeadNone\">with gradient</th></tr></thead><tbody>"
}
/^\| *kind *\|/ { inside = 1; next }
inside && !/^\|/ { exit }
inside && $2 !~ /---/ && cell(9) ~ /^[0-9.]+$/ && $2 !~ /model|form/ {
    printf "<tr data-preset=\"%d\"><td>%s</td><td>%s</td><td>%s</td><td>%s</td><td>%s</td></tr>\n",
           cell(2) == "preset", cell(3), cell(4), cell(7), cell(9), cell(10)
    ++rows
}
END {
    print "</tbody></table></div>\n<script>"
    while ((getline line < script) > 0) print line
    print "</script>\n\\endhtmlonly"
    if (rows < 10) { print "prices.awk: " rows + 0 " rows with times, expected 10 or more" > "/dev/stderr"; exit 1 }
}
