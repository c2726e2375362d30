// SPDX-License-Identifier: Apache-2.0
// gaze_dots.js CHROMIUM PAGE CSV: opens docs/gaze_dots.html from the disk, shows twelve dots as a person
// would, and writes the file that it offers to CSV. Fails if a wrong number is taken, if a dot is not where
// its line says, or if the times are not those of the clock.
"use strict";

const assert = require("node:assert");
const fs = require("node:fs");
const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { Browser } = require("../../examples/video_tracker/browser.js");

const width = 310, above = 8, right = 20, count = 12, seconds = 0.6;

async function main([chromium, page, file]) {
    const b = await Browser.start(chromium, [800, 500]);
    try {
        await b.call("Page.navigate", { url: pathToFileURL(path.resolve(page)).href });
        await b.until("document.readyState === 'complete'", 20000);
        const set = (id, value) => b.evaluate(`document.getElementById("${id}").value = "${value}"; true`);
        const press = async () => { // a click of a person, without which no page fills the screen
            const at = await b.evaluate(`(() => { const r = document.getElementById("start")
                .getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; })()`);
            for (const type of ["mousePressed", "mouseReleased"])
                await b.call("Input.dispatchMouseEvent",
                             { type, x: at[0], y: at[1], button: "left", buttons: 1, clickCount: 1 });
        };
        await set("count", 3);
        await press();
        await b.until("document.getElementById('fault').textContent !== ''", 5000);
        assert.match(await b.evaluate("document.getElementById('fault').textContent"),
                     /^Dots: got '3', expected 12 to 500$/);
        await set("count", count), await set("seconds", seconds);
        await set("width", width), await set("right", right), await set("above", above);
        // What is to be seen, and when, by the page's own clock.
        await b.evaluate(`window.seen = []; new MutationObserver(() => { const d = document.getElementById("dot");
            const r = d.getBoundingClientRect(); seen.push([performance.now(), r.x + r.width / 2,
            r.y + r.height / 2, innerWidth, innerHeight]); }).observe(document.getElementById("dot"),
            { attributes: true }); true`);
        await press();
        await b.until("!document.getElementById('end').hidden", 60000);
        const text = await b.evaluate(`fetch(document.getElementById("save").href).then(a => a.text())`);
        const lines = text.trim().split("\n"), seen = await b.evaluate("seen");
        assert.equal(lines.length, 1 + count);
        assert.equal(seen.length, count);
        lines.slice(1).forEach((line, i) => {
            const [begin, end, x, y] = line.split(",").map(Number), [at, u, v, w, h] = seen[i];
            assert.ok(end - begin > seconds - 0.02 && end - begin < seconds + 0.5, line);
            assert.ok(Math.abs((at - seen[0][0]) / 1000 - begin) < 0.3, `${line}: was set at ${at}`);
            const mm = width / w;
            assert.ok(Math.abs(x - ((u - w / 2) * mm - right)) < 0.6, `${line}: is at ${u} of ${w}`);
            assert.ok(Math.abs(y - (-v * mm - above)) < 0.6, `${line}: is at ${v} of ${h}`);
        });
        fs.writeFileSync(file, text);
        console.log(`${count} dots are where and when their file says`);
    } finally {
        await b.end();
    }
}

main(process.argv.slice(2)).catch((fault) => {
    console.error(fault.stack || String(fault));
    process.exit(1);
});
