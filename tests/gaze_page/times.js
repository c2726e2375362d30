// SPDX-License-Identifier: Apache-2.0
// times.js CHROMIUM PAGE [FLAG...]: prints the times of frames of the gaze page in PAGE, from the drivers to
// the bytes of the picture: by WebAssembly with one thread and with several, in turns, and by WebGPU. FLAGs
// are Chromium's; without any its WebGPU is SwiftShader, which is a processor's. From the environment:
//   ROUNDS    visits with each number of threads (3)
//   THREADS   the numbers of threads (1,2), SIZES the sides of pictures (256,512,1024)
//   WEBGPU    the sides of pictures by WebGPU (256,512), or 0
//   AVATAR    a file in PAGE instead of head.avatar
"use strict";

const os = require("node:os");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");

const [chromium, page, ...given] = process.argv.slice(2);
const flags = given.length > 0 ? given
    : ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"];
const { ROUNDS = "3", THREADS = "1,2", SIZES = "256,512,1024", WEBGPU = "256,512", AVATAR = "" } = process.env;
const numbers = (text) => text.split(",").map(Number);
const isolating = { "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" };

/// Run in the page: times [ms] of frames that change one thing.
const frames = (change, size, count) => `(async () => {
    const v = gazePage.avatar, times = [];
    await gazePage.show({}, ${size});
    for (let i = 1; i <= ${count}; ++i) times.push((await gazePage.show(${change}, ${size})).ms);
    return times;
})()`;
const changes = {
    "both gazes": "{ gaze: [0.01 * i, 0.02 * i, 0.01 * i, 0.02 * i] }",
    "an expression coefficient": "{ expression: v.expression.map((x, k) => x + (k === 0 ? 0.01 * i : 0)) }",
    "the camera": "{ motion: (orbit.turn(0.01, 0), orbit.motion()) }",
};
/// Run in the worker: times [ms] of driving alone.
const drives = `(() => {
    const times = [];
    for (let i = 1; i <= 9; ++i) {
        write(rye._page_gaze(), [0.01 * i, 0.02 * i, 0.01 * i, 0.02 * i]);
        const begun = performance.now();
        check(rye._page_drive(-1, 0.5));
        times.push(performance.now() - begun);
    }
    return times;
})()`;
const median = (x) => [...x].sort((a, b) => a - b)[x.length >> 1];

/// The page with no life of its own, once it shows a picture.
async function visit(b, url) {
    await b.call("Page.navigate", { url });
    await b.until("window.gazePage && gazePage.firstPicture !== null", 120000);
    await b.evaluate("document.getElementById('alive').checked = false; true");
    return b.evaluate("({ ...gazePage.last, first: gazePage.firstPicture, gaussians: gazePage.avatar.gaussians })");
}

async function byWasm(b, url) {
    const counts = numbers(THREADS), times = {}, loads = [];
    const keep = (what, count, got) => ((times[what] ??= {})[count] ??= []).push(...got);
    let gaussians = 0;
    for (let round = 0; round < Number(ROUNDS); ++round)
        for (const count of counts) {
            const last = await visit(b, `${url}&draw=wasm&threads=${count}`);
            if (last.threads !== count) throw new Error(`got ${last.threads} threads, expected ${count}`);
            ({ gaussians } = last);
            keep("first picture", count, [last.first]);
            for (const size of numbers(SIZES))
                for (const [what, change] of Object.entries(changes))
                    keep(`${size} x ${size}, ${what}`, count, await b.evaluate(frames(change, size, 7)));
            keep("driving alone, both gazes", count, await b.evaluate(drives, b.workers[0]));
            loads.push(os.loadavg()[0]);
        }
    console.log(`WebAssembly, ${gaussians} Gaussians, a load of ${Math.min(...loads).toFixed(1)} to ${Math.max(...loads).toFixed(1)}; ` +
                `[ms] least, median of ${ROUNDS} rounds in turns; ratios of both to ${counts[0]}`);
    console.log(`${"".padEnd(40)}${counts.map((n) => `${n} thread${n === 1 ? "" : "s"}`.padStart(18)).join("")}`);
    for (const [what, of] of Object.entries(times)) {
        const pairs = counts.map((n) => [Math.min(...of[n]), median(of[n])]);
        const ratios = pairs.slice(1).map((p) => [0, 1].map((k) => (pairs[0][k] / p[k]).toFixed(2)).join(", "));
        console.log(what.padEnd(40) + pairs.map((p) => p.map((x) => x.toFixed(1).padStart(9)).join("")).join("") +
                    ratios.map((r) => `   ${r}`).join(""));
    }
}

async function byWebGpu(b, url) {
    const last = await visit(b, `${url}&draw=webgpu`);
    if (last.by !== "webgpu") return console.log(`not run: times of WebGPU: ${last.note}`);
    const device = await b.evaluate("drawing.gpu.name", b.workers[0]);
    console.log(`WebGPU (${device}), ${last.gaussians} Gaussians: first picture after ${(last.first / 1000).toFixed(2)} s`);
    for (const size of numbers(WEBGPU))
        for (const [what, change] of Object.entries(changes))
            console.log(`  ${size} x ${size}, ${what}: median of 5 ` +
                        `${median(await b.evaluate(frames(change, size, 5))).toFixed(1)} ms`);
}

async function main() {
    if (!page) throw new Error("times.js: expected CHROMIUM PAGE [FLAG...]");
    const server = await serve([page], isolating);
    const url = `http://127.0.0.1:${server.address().port}/?${AVATAR ? `avatar=${AVATAR}` : ""}`;
    const b = await Browser.start(chromium, [1100, 1100], flags);
    try {
        console.log(`${(await b.call("Browser.getVersion")).product}; ${os.cpus()[0].model}, ${os.cpus().length} ` +
                    `processors, a load of ${os.loadavg()[0].toFixed(1)}`);
        await byWasm(b, url);
        if (WEBGPU !== "0") await byWebGpu(b, url);
    } finally {
        await b.end();
        server.close();
    }
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
