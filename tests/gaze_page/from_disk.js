// SPDX-License-Identifier: Apache-2.0
// from_disk.js CHROMIUM PAGE PICTURE: opens the folder PAGE, a gaze page with its avatar, as a double click
// does, writes what is to be seen to PICTURE, and fails if that is empty or if no gaze changes it.
"use strict";

const path = require("node:path");
const { pathToFileURL } = require("node:url");
const { Browser } = require("../../examples/video_tracker/browser.js");

/// Run in the page: a number of all bytes of the picture.
const sum = `(() => { const c = document.getElementById("picture");
    return c.getContext("2d").getImageData(0, 0, c.width, c.height).data
        .reduce((h, byte) => (Math.imul(h, 16777619) ^ byte) >>> 0, 2166136261); })()`;

/// Run in the page: the share of pixels that are visibly not the colour of the first.
const share = `(() => { const c = document.getElementById("picture");
    const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
    let n = 0;
    for (let i = 0; i < d.length; i += 4)
        if (Math.abs(d[i] - d[0]) + Math.abs(d[i+1] - d[1]) + Math.abs(d[i+2] - d[2]) > 24) ++n;
    return n / (c.width * c.height); })()`;

/// The picture at a gaze [rad], where the folder is opened from a disk; time to the first [ms].
async function fromDisk(b, folder, gaze, width) {
    b.faults.length = 0;
    const begin = Date.now();
    await b.call("Page.navigate", { url: pathToFileURL(path.resolve(folder, "index.html")).href });
    await b.until("location.protocol === 'file:' && window.gazePage && gazePage.firstPicture !== null", 60000);
    const first = Date.now() - begin;
    await b.evaluate(`gazePage.show({ gaze: ${JSON.stringify(gaze)},
        expression: gazePage.avatar.expression }, ${width || "gazePage.avatar.width"})`);
    return { first, sum: await b.evaluate(sum), share: await b.evaluate(share),
             faults: [...b.faults, ...await b.evaluate("gazePage.errors")] };
}

async function main([chromium, page, picture]) {
    if (!picture) {
        console.error("from_disk.js: expected CHROMIUM PAGE PICTURE");
        process.exit(2);
    }
    const b = await Browser.start(chromium, [1280, 860]);
    try {
        const left = await fromDisk(b, page, [0, 0.2, 0, 0.2]);
        await b.screenshot(picture);
        const right = await fromDisk(b, page, [0, -0.2, 0, -0.2]);
        const good = left.share > 0.1 && left.sum !== right.sum && left.faults.length + right.faults.length === 0;
        console.log(`${good ? "" : "FAILED: "}first picture after ${left.first} ms, ` +
                    `${(100 * left.share).toFixed(0)} % of its pixels unlike its corner, eyes ` +
                    `${left.sum === right.sum ? "that stay" : "that turn"}; faults: ` +
                    `${[...left.faults, ...right.faults].join("; ") || "none"}`);
        process.exitCode = good ? 0 : 1;
    } finally {
        await b.end();
    }
}

module.exports = { fromDisk, sum };
if (require.main === module)
    main(process.argv.slice(2)).catch((fault) => {
        console.error(String(fault.stack || fault));
        process.exit(1);
    });
