// SPDX-License-Identifier: Apache-2.0
// visit.js CHROMIUM SITE PICTURES [ALL]: headless Chromium visits pages of the site at the widths of a
// phone (390) and a desktop (1440): none is wider than the window, none has faults, and the search finds
// a name. Screenshots of some pages go to PICTURES. With ALL every page is visited, else the guide, the
// results and some of the names.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");

const [chromium, site, pictures, all] = process.argv.slice(2);
if (!pictures) {
    console.error("visit.js: expected CHROMIUM SITE PICTURES [ALL]");
    process.exit(2);
}
const shown = ["index", "guide", "program", "gallery", "prices", "lessons", "parts", "results_performance",
               "conceptrye_1_1GazeMechanism", "classrye_1_1AvatarTrainer", "concepts", "annotated", "files"];

(async () => {
    const names = fs.readdirSync(site).filter((f) => f.endsWith(".html")).map((f) => f.slice(0, -5));
    const pages = all ? names : names.filter((n) => shown.includes(n) || !/_|^(dir|globals|functions|namespacemembers|class|struct)/.test(n) ||
                                             n.startsWith("results_"));
    for (const name of shown)
        if (!names.includes(name)) throw new Error(`the site has no page ${name}`);
    fs.mkdirSync(pictures, { recursive: true });
    const server = await serve([site]);
    const browser = await Browser.start(chromium, [1440, 900]);
    let wrong = 0;
    try {
        const visit = async (name) => {
            await browser.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/${name}.html` });
            await browser.until(`document.readyState === "complete" && location.pathname.endsWith("/${name}.html")`, 120000);
        };
        for (const width of [1440, 390]) {
            await browser.view(width, 900, width < 500);
            for (const name of pages) {
                await visit(name);
                const wide = await browser.evaluate("document.documentElement.scrollWidth");
                if (wide > width) {
                    const who = await browser.evaluate(`[...document.querySelectorAll("body *")].filter((e) =>
                        e.getBoundingClientRect().right > ${width + 1}).slice(0, 3).map((e) =>
                        e.tagName + "." + e.className).join(", ")`);
                    console.log(`${name}.html is ${wide} px wide in a window of ${width}: ${who}`);
                    ++wrong;
                }
                const broken = await browser.evaluate(
                    `Promise.all([...document.querySelectorAll("div.contents img")].map((i) => i.decode()
                        .then(() => 0, () => 1))).then((x) => x.reduce((a, b) => a + b, 0))`);
                if (broken) { console.log(`${name}.html: ${broken} pictures do not load`); ++wrong; }
                if (shown.includes(name)) await browser.screenshot(path.join(pictures, `${name}_${width}.png`));
            }
            await visit("prices"); // the slider keeps its bounds, and says so where nothing does
            const says = await browser.evaluate(`["-2.4", "-4", "-14"].map((at) => {
                const bound = document.getElementById("prices-bound");
                bound.value = at;
                bound.dispatchEvent(new Event("input"));
                return document.getElementById("prices-says").textContent; })`);
            const error = (words) => Number(/an error of (\S+) at most/.exec(words)?.[1]);
            if (!(error(says[0]) > 1e-4 && error(says[0]) <= 10 ** -2.4) || !(error(says[1]) <= 1e-4) ||
                says[2] !== "No policy is as exact as that.") {
                console.log(`prices.html: the slider says ${JSON.stringify(says)}`);
                ++wrong;
            }
            await visit("index");
            await browser.until(`document.getElementById("MSearchField") !== null`, 60000);
            await browser.evaluate(`(() => { const f = document.getElementById("MSearchField"); f.focus();
                f.value = "AvatarTrainer"; searchBox.OnSearchFieldFocus(true); searchBox.Search(); })()`);
            await browser.until(`[...document.querySelectorAll("iframe")].concat([...document.querySelectorAll("#MSearchResults")])
                .some((e) => ((e.contentDocument && e.contentDocument.body) || e).textContent.includes("AvatarTrainer"))`, 60000);
            await browser.screenshot(path.join(pictures, `search_${width}.png`));
        }
        for (const fault of browser.faults.filter((f) => !f.includes("favicon.ico"))) { console.log(`fault: ${fault}`); ++wrong; }
    } finally {
        await browser.end();
        server.close();
    }
    if (wrong) process.exit(1);
    console.log(`${pages.length} pages at 1440 and 390 px: none is wider than its window, and the search finds names`);
})().catch((e) => { console.error(e.message); process.exit(1); });
