// SPDX-License-Identifier: Apache-2.0
// times.js CHROMIUM PAGE [FLAG...]: prints the times of frames of the gaze page in PAGE, by WebAssembly
// and by WebGPU, from the drivers to the bytes of the picture. FLAGs are Chromium's; without any its
// WebGPU is SwiftShader, which is a processor's.
"use strict";

const os = require("node:os");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");

const [chromium, page, ...given] = process.argv.slice(2);
const flags = given.length > 0 ? given
    : ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"];

/// Run in the page: the median time [ms] of frames that change one thing.
const median = (change, size) => `(async () => {
    const v = gazePage.avatar, times = [];
    await gazePage.show({}, ${size});
    for (let i = 1; i <= 5; ++i) times.push((await gazePage.show(${change}, ${size})).ms);
    return times.sort((a, b) => a - b)[2];
})()`;
const changes = {
    "both gazes": "{ gaze: [0.01 * i, 0.02 * i, 0.01 * i, 0.02 * i] }",
    "an expression coefficient": "{ expression: v.expression.map((x, k) => x + (k === 0 ? 0.01 * i : 0)) }",
    "the camera": "{ motion: (orbit.turn(0.01, 0), orbit.motion()) }",
};

async function main() {
    if (!page) throw new Error("times.js: expected CHROMIUM PAGE [FLAG...]");
    const server = await serve([page]);
    const b = await Browser.start(chromium, [800, 800], flags);
    try {
        console.log(`${(await b.call("Browser.getVersion")).product}; ${os.cpus()[0].model}, ${os.cpus().length} ` +
                    `processors, a load of ${os.loadavg()[0].toFixed(1)}`);
        for (const by of ["wasm", "webgpu"]) {
            await b.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/?draw=${by}` });
            await b.until("window.gazePage && gazePage.firstPicture !== null", 120000);
            await b.evaluate("document.getElementById('alive').checked = false; true");
            const { last, first, gaussians } = await b.evaluate(
                "({ last: gazePage.last, first: gazePage.firstPicture, gaussians: gazePage.avatar.gaussians })");
            if (last.by !== by) {
                console.log(`not run: times of ${by}: ${last.note}`);
                continue;
            }
            const device = by === "webgpu" ? await b.evaluate("drawing.gpu.name", b.workers.at(-1)) : "one thread";
            console.log(`${by} (${device}), ${gaussians} Gaussians: first picture after ${(first / 1000).toFixed(2)} s`);
            for (const size of [256, 512])
                for (const [what, change] of Object.entries(changes))
                    console.log(`  ${size} x ${size}, ${what}: median of 5 ` +
                                `${(await b.evaluate(median(change, size))).toFixed(1)} ms`);
            const driven = await b.evaluate(`(() => {
                const times = [];
                for (let i = 1; i <= 9; ++i) {
                    write(rye._page_gaze(), [0.01 * i, 0.02 * i, 0.01 * i, 0.02 * i]);
                    const begun = performance.now();
                    check(rye._page_drive(-1, 0.5));
                    times.push(performance.now() - begun);
                }
                return times.sort((a, b) => a - b)[4];
            })()`, b.workers.at(-1));
            console.log(`  of which driving by both gazes, in WebAssembly: ${driven.toFixed(1)} ms`);
        }
    } finally {
        await b.end();
        server.close();
    }
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
