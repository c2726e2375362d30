// SPDX-License-Identifier: Apache-2.0
// threads.js CHROMIUM PAGE OUT [AVATAR]: the gaze page in PAGE, and its file AVATAR, by several threads of
// WebAssembly: the bytes of one; and by one thread where there can be no more. Writes pages with a file that
// is missing or wrong to OUT. Prints each figure with its bound, and fails if a bound does not hold.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");
const { sum } = require("./from_disk.js");
const { Figures } = require("./measures.js");

const [chromium, page, out, another] = process.argv.slice(2);
const isolating = { "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" };
const figures = new Figures();
const figure = figures.add.bind(figures);

/// Frames: what differs from the one before, and the side [px].
const frames = [
    ["{ gaze: [0.1, 0.3, 0.1, 0.3] }", 256], ["{ gaze: [0.2, -0.2, -0.2, 0.1] }", 256],
    ["{ expression: v.low.map((x, i) => x + 0.7 * (v.high[i] - x)) }", 256],
    ["{ pose: v.pose.map((x, i) => (i === 1 ? x + 0.3 : x)) }", 256],
    ["{ motion: (orbit.turn(0.7, 0.2), orbit.motion()) }", 256], ["{ idle: 12.5 }", 300], ["{}", 512],
    ["{ background: Array.from({ length: v.channels }, (_, i) => (i % 3) / 4) }", 101],
];

/// The page at an address with no life of its own, once it shows a picture.
async function visit(b, url) {
    await b.call("Page.navigate", { url });
    await b.until("window.gazePage && gazePage.firstPicture !== null", 60000);
    await b.evaluate("document.getElementById('alive').checked = false; true");
    await b.until("!busy && !gazePage.lives && Object.keys(wanted).length === 0", 20000);
    return b.evaluate("gazePage.last.threads");
}

/// Numbers of all bytes of the frames.
async function drawn(b, some = frames) {
    const sums = [];
    for (const [parts, side] of some) {
        await b.evaluate(`(() => { const v = gazePage.avatar; return gazePage.show(${parts}, ${side}); })()`);
        sums.push(await b.evaluate(sum));
    }
    return sums;
}

async function main() {
    if (!out) throw new Error("threads.js: expected CHROMIUM PAGE OUT [AVATAR]");
    const other = path.join(out, "threads");
    fs.rmSync(other, { recursive: true, force: true });
    fs.mkdirSync(other, { recursive: true });
    const plain = await serve([page]), isolated = await serve([other, page], isolating);
    const at = (server, query) => `http://127.0.0.1:${server.address().port}/?draw=wasm${query}`;
    const b = await Browser.start(chromium, [800, 800]);
    try {
        const sets = [["", "", [2, 5], frames], [another, ", a network that doubles", [3], frames.slice(0, 5)]];
        for (const [avatar, what, counts, some] of sets) {
            if (avatar === undefined) continue;
            const query = avatar ? `&avatar=${avatar}` : "";
            const one = await visit(b, at(isolated, `&threads=1${query}`)), right = await drawn(b, some);
            for (const count of counts) {
                const got = await visit(b, at(isolated, `&threads=${count}${query}`)), sums = await drawn(b, some);
                const same = sums.filter((x, i) => x === right[i]).length;
                figure(`${count} threads${what}: frames that are those of one`, `${same} of ${some.length}`,
                       one === 1 && got === count && same === some.length && new Set(right).size === some.length,
                       "all, each another");
            }
        }
        // Another avatar in the same module: its threads are used again.
        const one = Array(3).fill(await b.evaluate("gazePage.last.threads"));
        const again = await b.evaluate(`(async () => {
            const bytes = await (await fetch("head.avatar")).arrayBuffer(), found = [];
            for (let i = 0; i < 3; ++i) {
                const { frames } = gazePage;
                open(bytes.slice(0), "head.avatar");
                while (gazePage.frames === frames)
                    await new Promise((done) => setTimeout(done, 5));
                found.push((await gazePage.show({ gaze: [0, 0.2, 0, 0.2] }, 128)).threads);
            }
            return found.join();
        })()`);
        figure("three files after each other: threads", again, again === one.join(), one.join());

        const here = await visit(b, at(isolated, "")), most = await b.evaluate("navigator.hardwareConcurrency");
        figure("a page that is cross-origin isolated: threads", String(here), here === Math.min(most, 8), `${Math.min(most, 8)}`);
        const [usual] = await drawn(b, frames.slice(0, 1));
        const cases = {
            "a page that is not": [null, () => {}],
            "a script of a thread that is missing": ["rye_threads.js", (text) => text.replace(/rye_threads[.]worker[.]js/, "no.js")],
            "a script of a thread that fails": ["rye_threads.worker.js", () => "throw new Error('no');"],
            "a module that is none": ["rye_threads.wasm", () => "no module"],
        };
        b.faults.length = 0;
        for (const [what, [name, change]] of Object.entries(cases)) {
            if (name) {
                if (!fs.existsSync(path.join(page, name))) continue; // of other emscriptens
                fs.writeFileSync(path.join(other, name), change(fs.readFileSync(path.join(page, name), "latin1")));
            }
            const got = await visit(b, at(name ? isolated : plain, "&threads=4"));
            const [shown] = await drawn(b, frames.slice(0, 1));
            figure(`${what}: threads, the same picture`, `${got}, ${shown === usual}`, got === 1 && shown === usual, "1, true");
            if (name) fs.rmSync(path.join(other, name));
        }
        const faults = b.faults.filter((text) => !/no[.]js|Uncaught Error: no/.test(text));  // what was broken
        const said = await b.evaluate("gazePage.errors");
        figure("errors of the page and of the console", String(faults.length + said.length), faults.length + said.length === 0, "0");
        for (const fault of [...faults, ...said]) console.log(`  ${fault}`);

        await b.call("Page.navigate", { url: at(isolated, "&threads=0") });
        await b.until("window.gazePage && document.getElementById('notice').textContent.includes('?threads: got 0')", 20000);
        await b.call("Page.navigate", { url: new URL("npm/example.html", at(isolated, "")).href });
        await b.until("window.head !== undefined", 60000);
        const pack = await b.evaluate(`(async () => {
            const { Head } = await import("./head.mjs"), bytes = await (await fetch("head.avatar")).arrayBuffer();
            const all = await Promise.all([1, 3].map((threads) => Head.open(bytes.slice(0), { draw: "wasm", threads })));
            const [a, c] = await Promise.all(all.map((h) => h.draw({ gaze: [0, 0.2, 0, 0.2], width: 128 })));
            const fault = await Head.open(bytes, { threads: 1.5 }).then(() => "", (e) => e.message);
            return [a.threads, c.threads, a.picture.data.every((x, i) => x === c.picture.data[i]), /^threads: got 1.5/.test(fault)].join();
        })()`);
        figure("rye-head: threads, the same bytes, an error by name", pack, pack === "1,3,true,true", "1,3,true,true");
    } finally {
        await b.end();
        plain.close();
        isolated.close();
    }
    figures.end();
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
