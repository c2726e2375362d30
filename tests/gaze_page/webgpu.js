// SPDX-License-Identifier: Apache-2.0
// webgpu.js CHROMIUM PAGE OUT [AVATAR]: the pictures that the gaze page in PAGE draws by WebGPU, on
// SwiftShader's adapter, of its avatar and of another file there, against those of the headers in the
// same module, pixel by pixel; and that nothing is lost where there is no device, where it is lost, or
// where a shader is wrong. PAGE was built with MORE=features.c. Prints each figure with its bound,
// writes screenshots to OUT, and fails if a bound does not hold. Where Chromium offers no adapter it says so.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");
const { sum } = require("./from_disk.js");
const { Figures } = require("./measures.js");

const [chromium, page, out, another] = process.argv.slice(2);
const flags = ["--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"];
const figures = new Figures();
const figure = figures.add.bind(figures);
const presets = ["Balanced", "Fast", "Tight"];

/// Frames: what differs from the one before. Small: the device is a processor.
const frames = [
    { what: "ahead", parts: "{}", size: [256, 256] },
    { what: "eyes to the left", parts: "{ gaze: [0.1, 0.3, 0.1, 0.3] }", size: [128, 128] },
    { what: "eyes apart, up and down", parts: "{ gaze: [0.2, -0.2, -0.2, 0.1] }", size: [128, 128] },
    { what: "an expression", parts: "{ expression: low.map((x, i) => x + 0.7 * (high[i] - x)) }", size: [128, 128] },
    { what: "the head turned", parts: "{ pose: pose.map((x, i) => (i === 1 ? x + 0.3 : x)) }", size: [128, 128] },
    { what: "from the side", parts: "{ motion: seen(0.7, 0.2, 1) }", size: [96, 96] },
    { what: "from near, wide", parts: "{ motion: seen(-0.4, 0, 2.4) }", size: [200, 88] },
    { what: "300 x 300", parts: "{ motion: seen(0, 0, 1) }", size: [300, 300] },
    { what: "41 x 67: long lists", parts: "{ lookAt: [0.3, 0.2, 3] }", size: [41, 67] },
    { what: "eyes that live by themselves", parts: "{ idle: 12.5 }", size: [128, 128] },
    { what: "another background", parts: "{ background: behind }", size: [128, 128] },
];

/// A frame as rye_draw has it: with training's dilation at any size.
const ofHeaders = "const ofHeaders = (...of) => {" +
    " const f = frame(...of); f.rules.dilation = 0.3; return f; };";

/// Run in the worker: draws a frame by WebGPU twice, and by the headers: [dB] between the pictures, at
/// each preset [dB] between the features, whether both draws are the same bytes. Presets leave out a
/// Gaussian of an opacity below 1 / 255 at a pixel, which two roundings of it may lie on either side
/// of: numbers of features, up to about 2, that are apart by more than 1e-4 are counted by themselves.
const compare = ({ parts, size: [width, height] }) => `(async () => {
    ${ofHeaders}
    const { low, high, pose, seen, behind } = self.scene;
    const parts = ${parts}, { idle = -1 } = parts, db = (a, b, peak) => {
        let sum = 0;
        for (let i = 0; i < a.length; ++i) sum += (a[i] - b[i]) ** 2;
        return 10 * Math.log10((peak * peak) / Math.max(sum / a.length, 1e-12 * peak * peak));
    };
    const first = await draw({ ...parts, width: ${width}, height: ${height} });
    const again = await draw({ idle, width: ${width}, height: ${height} });
    const lists = [], cut = { share: 0, most: 0 };
    for (const accuracy of [0, 1, 2]) {
        const got = await drawing.features(ofHeaders(${width}, ${height}, accuracy));
        const at = rye._page_features(accuracy);
        if (at === 0) throw new Error("the headers drew no features");
        const wanted = here(at, got.length).slice();
        let apart = 0;
        got.forEach((x, i) => {
            const off = Math.abs(x - wanted[i]);
            if (!(off > 1e-4)) return;
            ++apart;
            cut.most = Math.max(cut.most, off);
            wanted[i] = x;
        });
        cut.share = Math.max(cut.share, apart / got.length);
        lists.push(db(got, wanted, 1));
    }
    const a = new Uint8Array(first.picture), b = new Uint8Array(again.picture);
    const right = new Uint8Array(byWasm(idle, ${width}, ${height}));
    const colours = (x) => x.filter((_, i) => i % 4 !== 3);
    return { by: [first.by, again.by].join(), note: first.note, same: a.every((x, i) => x === b[i]),
             picture: db(colours(a), colours(right), 255), features: lists, cut,
             opaque: a.every((x, i) => i % 4 !== 3 || x === 255),
             filled: colours(a).filter((x) => x !== a[0]).length / (3 * ${width} * ${height}) };
})()`;

/// Run in the worker: [dB] at each preset between renders of a cloud of hard cases, put where the
/// avatar's Gaussians are: equal depths, opacities of 1, 0 and nearly 0, needles, points, a quaternion of
/// 0, what is beside the picture, behind the camera, or nearer than its near plane.
const hardCases = `(async () => {
    ${ofHeaders}
    const [width, height] = [112, 80], few = 1500;
    check(rye._page_size(width, height));
    check(rye._page_drive(-1, 0.5));
    let state = 1;
    const random = (low, high) => {
        state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
        return low + ((high - low) * state) / 2 ** 32;
    };
    const { cloud, camera: { motion: m, near } } = frame(width, height);
    cloud.opacity.fill(0);
    for (let i = 0; i < few; ++i) {
        const kind = i % 10, z = kind === 1 ? -3 : kind === 2 ? near * random(0.5, 1.5) : random(4, 14);
        const reach = kind === 3 ? 0.8 : 0.15, point = [z * random(-reach, reach), z * random(-reach, reach), z];
        for (const k of [0, 1, 2])
            cloud.mean[3 * i + k] = [0, 1, 2].reduce((s, j) => s + m[4 * j + k] * (point[j] - m[4 * j + 3]), 0);
        if (kind === 4) cloud.mean.copyWithin(3 * i, 3 * (i - 4), 3 * (i - 3));  // at the same place
        for (const k of [0, 1, 2, 3]) cloud.rotation[4 * i + k] = kind === 5 ? 0 : random(-2, 2);
        for (const k of [0, 1, 2])
            cloud.scale[3 * i + k] = kind === 6 ? 0 : kind === 7 && k > 0 ? 1e-5
                : kind === 3 ? random(0.3, 2) : kind === 2 ? random(0.001, 0.01) : random(0.01, 0.15);
        cloud.opacity[i] = kind === 8 ? 1e-5 * random(0, 60) : kind === 9 || kind === 4 ? 1
            : kind === 2 || kind === 3 ? 0.02 : random(0, 1);
        for (let c = 0; c < cloud.feature.length / cloud.opacity.length; ++c)
            cloud.feature[(cloud.feature.length / cloud.opacity.length) * i + c] = random(0, 1);
    }
    const all = [];
    for (const accuracy of [0, 1, 2]) {
        const wanted = ofHeaders(width, height, accuracy), at = rye._page_features(accuracy);
        delete wanted.cloud.moves;  // it was changed by hand
        const got = await drawing.features(wanted);
        let sum = 0;
        here(at, got.length).forEach((x, i) => { sum += (x - got[i]) ** 2; });
        all.push(10 * Math.log10(1 / Math.max(sum / got.length, 1e-12)));
    }
    return all;
})()`;

/// The page at an address, once it shows a picture.
async function visit(b, url) {
    await b.call("Page.navigate", { url });
    await b.until("window.gazePage && gazePage.firstPicture !== null", 120000);
    return b.evaluate("gazePage.last");
}

async function drawsAlike(b, url, frames, picture) {
    const last = await visit(b, url);
    if (last.by !== "webgpu") {
        if (!/^(this browser has no WebGPU|WebGPU has )/.test(last.note)) throw new Error(`WebGPU draws nothing: ${last.note}`);
        console.log(`not run: gaze_page: pictures by WebGPU: ${last.note}`);
        return false;
    }
    const worker = b.workers.at(-1);
    const { gaussians, channels } = await b.evaluate("gazePage.avatar");
    console.log(`by WebGPU on SwiftShader: ${gaussians} Gaussians of ${channels} channels; ` +
                `[dB] to the headers: the picture; the render at ${presets.join(", ")}`);
    await b.screenshot(path.join(out, picture));
    await b.evaluate("document.getElementById('alive').checked = false; true");
    await b.until("!busy && !gazePage.lives && Object.keys(wanted).length === 0", 60000);
    const scene = await b.evaluate(`(() => {
        const seen = (yaw, pitch, zoom) => { orbit.reset(); orbit.turn(yaw, pitch); orbit.magnify(zoom);
            const m = orbit.motion(); orbit.reset(); return [...m]; };
        const views = [[0.7, 0.2, 1], [-0.4, 0, 2.4], [0, 0, 1]].map((v) => [v.join(), seen(...v)]);
        return { low: avatar.low, high: avatar.high, pose: avatar.pose, views };
    })()`);
    await b.evaluate(`(() => { const s = ${JSON.stringify(scene)}, views = Object.fromEntries(s.views);
        self.scene = { ...s, seen: (...v) => views[v.join()],
                       behind: Array.from({ length: ${channels} }, (_, i) => (i % 3) / 4) }; })()`, worker);
    for (const f of frames) {
        const got = await b.evaluate(compare(f), worker);
        if (got.by !== "webgpu,webgpu") throw new Error(`${f.what}: drawn by ${got.by}: ${got.note}`);
        const { share, most } = got.cut;
        figure(`${f.what} [dB]`, [got.picture, ...got.features].map((x) => (x >= 119.9 ? ">119" : x.toFixed(1))).join(", ") +
                   (share > 0 ? `; ${(100 * share).toFixed(4)} % cut otherwise, by ${most.toFixed(4)} at most` : ""),
               got.picture >= 80 && Math.min(...got.features) >= 100 && share <= 2e-4 && most <= 2 / 255 &&
                   got.filled > 0.05 && got.opaque,
               "at least 80, renders 100; cut otherwise 0.02 %, by 2 / 255");
        if (!got.same) figure(`${f.what}: two draws`, "differ", false, "the same bytes");
    }
    figure("two draws of each frame", "the same", true, "the same bytes");
    const grown = await b.evaluate(`(async () => {
        const sum = async () => new Uint8Array((await draw({ width: 64, height: 64 })).picture)
            .reduce((h, byte) => (Math.imul(h, 16777619) ^ byte) >>> 0, 2166136261);
        const right = await sum();
        drawing.splats.most = 1000;
        return [right === await sum(), drawing.splats.most > 1000];
    })()`, worker);
    figure("lists that had no room: the same bytes, more room", grown.join(), grown.join() === "true,true", "true,true");
    const between = await b.evaluate(`(async () => {
        const size = { width: 96, height: 96 }, of = (yaw) => [0, yaw, 0, yaw];
        const bytes = async (yaw) => new Uint8Array((await draw({ gaze: of(yaw), ...size })).picture);
        const right = await bytes(-0.3), other = await bytes(0.3);
        write(rye._page_gaze(), of(-0.3));
        byWasm(-1, 96, 96);  // after it no drive moves a Gaussian
        const got = await bytes(-0.3), same = (x) => got.every((byte, i) => byte === x[i]);
        return [same(right), same(other)];
    })()`, worker);
    figure("Gaussians that WebAssembly moved between: as right, as before", between.join(),
           between.join() === "true,false", "true,false");
    const hard = await b.evaluate(hardCases, worker);
    figure("a render of hard cases [dB]", hard.map((x) => x.toFixed(1)).join(", "), Math.min(...hard) >= 100, "at least 100");
    return true;
}

async function losesNothing(b, url) {
    const shown = `gazePage.show({ gaze: [0, 0.2, 0, 0.2] }, 256)`;
    await visit(b, `${url}?draw=wasm`);
    const plain = await b.evaluate(shown), right = await b.evaluate(sum);
    figure("?draw=wasm: drawn by, and no note", `${plain.by} ${plain.note}`.trim(), plain.by === "wasm" && !plain.note, "wasm");
    await visit(b, `${url}?draw=webgpu`);
    await b.evaluate("drawing.gpu.device.destroy(); true", b.workers.at(-1));
    const lost = await b.evaluate(shown);
    figure("the device lost: drawn by", lost.by, lost.by === "wasm" && /device was lost/.test(lost.note), "wasm, and a note");
    figure("... the picture is WebAssembly's", String(await b.evaluate(sum) === right), await b.evaluate(sum) === right, "true");
    await b.until("document.getElementById('by').textContent.includes('lost')", 1000);

    const last = await visit(b, url);
    const automatic = await b.evaluate(`(async () => {
        for (let i = 0; i < 100 && !gazePage.last.note && gazePage.last.by === "wasm"; ++i) {
            await new Promise((done) => setTimeout(done, 50));
            await gazePage.show({});
        }
        return gazePage.last;
    })()`);
    figure("without ?draw, on software: drawn by", automatic.by, last.by === "wasm" && automatic.by === "wasm" &&
           /software/.test(automatic.note), "wasm, and a note");

    // The same page with another text in webgpu.js.
    const other = path.join(out, "other"), text = fs.readFileSync(path.join(page, "webgpu.js"), "utf8");
    fs.mkdirSync(other, { recursive: true });
    const server = await serve([other, page]), address = `http://127.0.0.1:${server.address().port}/`;
    const put = (from, to) => {
        if (!text.includes(from)) throw new Error(`webgpu.js has no ${from}`);
        fs.writeFileSync(path.join(other, "webgpu.js"), text.replace(from, to));
    };
    put("if (!software &&", "if (false &&");
    const early = await visit(b, address);
    await b.until("gazePage.last.by === 'webgpu' || (busy || gazePage.show({}), false)", 120000);
    figure("without ?draw, as if on hardware: drawn by", `${early.by}, ${await b.evaluate("gazePage.last.by")}`,
           early.by === "wasm", "wasm, webgpu");
    await b.until("!busy", 60000);
    await b.evaluate("drawing.splats.most = 2 ** 29; true", b.workers.at(-1));
    const large = await b.evaluate(shown);
    figure("lists beyond what the device holds: drawn by", large.by,
           large.by === "wasm" && /^a buffer would take 6442450944 bytes/.test(large.note), "wasm, and a note");
    figure("... the picture is WebAssembly's", String(await b.evaluate(sum) === right), await b.evaluate(sum) === right, "true");
    put("let inside = pixel.x", "let inside = pixels.x");
    const wrong = await visit(b, `${address}?draw=webgpu`);
    figure("a wrong shader: drawn by", wrong.by, wrong.by === "wasm" && wrong.note.startsWith("blend.wgsl:"), "wasm, and its name");
    await b.evaluate(shown);
    figure("... the picture is WebAssembly's", String(await b.evaluate(sum) === right), await b.evaluate(sum) === right, "true");
    server.close();
}

/// Cross-origin isolated: WebGPU reads a memory that threads share.
async function inPackage(b) {
    const server = await serve([page], { "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" });
    await b.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/npm/example.html` });
    await b.until("window.head !== undefined", 60000);
    const pack = await b.evaluate(`(async () => {
        const { Head } = await import("./head.mjs"), bytes = await (await fetch("head.avatar")).arrayBuffer();
        const head = await Head.open(bytes.slice(0), { draw: "webgpu", threads: 2 });
        const parts = { gaze: [0, 0.2, 0, 0.2], width: 64 };
        const [a, c] = await Promise.all([head.draw(parts), head.draw({ gaze: [0, -0.2, 0, -0.2], width: 64 })]);
        const other = await (await Head.open(bytes, { draw: "wasm" })).draw(parts);
        const fault = await Head.open("head.avatar", { draw: "gl" }).then(() => "", (e) => e.message);
        const short = await head.draw({ background: [1] }).then(() => "", (e) => e.message);
        const off = (p, q) => p.picture.data.reduce((m, x, i) => Math.max(m, Math.abs(x - q.picture.data[i])), 0);
        return { by: [a.by, c.by, other.by, a.threads].join(), apart: off(a, other), turned: off(a, c), fault, short };
    })()`);
    server.close();
    figure("rye-head: drawn by, threads", pack.by, pack.by === "webgpu,webgpu,wasm,2", "webgpu,webgpu,wasm,2");
    figure("... off WebAssembly, and off another gaze", `${pack.apart}, ${pack.turned}`,
           pack.apart <= 1 && pack.turned > 4, "at most 1, above 4");
    figure("... a wrong `draw`, a wrong background are errors", "", /^draw: got gl/.test(pack.fault) &&
           /^background: got 1 numbers/.test(pack.short), "by name");
}

async function main() {
    if (!out) throw new Error("webgpu.js: expected CHROMIUM PAGE OUT");
    fs.mkdirSync(out, { recursive: true });
    const server = await serve([page]);
    const url = `http://127.0.0.1:${server.address().port}/`;
    const b = await Browser.start(chromium, [1280, 860], flags);
    try {
        if (await drawsAlike(b, `${url}?draw=webgpu`, frames, "webgpu.png")) {
            if (another) await drawsAlike(b, `${url}?draw=webgpu&avatar=${another}`, [frames[1], frames[6], frames[8]],
                                              "doubled.png");
            await losesNothing(b, url);
            await inPackage(b);
        }
        figure("errors of the page and of the console", String(b.faults.length), b.faults.length === 0, "0");
        for (const fault of b.faults) console.log(`  ${fault}`);
    } finally {
        await b.end();
    }
    const without = await Browser.start(chromium, [1280, 860]);
    try {
        const last = await visit(without, `${url}?draw=webgpu`);
        figure("without an adapter: drawn by", last.by, last.by === "wasm" && last.note !== "", "wasm, and a note");
        console.log(`  ${last.note}`);
    } finally {
        await without.end();
        server.close();
    }
    figures.end();
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
