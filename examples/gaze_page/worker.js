// SPDX-License-Identifier: Apache-2.0
// worker.js: rye in a thread of its own, so that the page stays responsive. Messages in:
//   {start: ArrayBuffer or null}        the first: rye.wasm, or that it is to be read from the host
//   {open: ArrayBuffer, name}           an avatar file
//   {draw: {gaze, expression, pose, motion, width, height}, id}   any of these; the rest stays.
//     With `lookAt`, a point of the world, both eyes look there; with `idle`, seconds, they live by
//     themselves, in this picture alone
// Messages out: {opened: {...}}, {picture: ArrayBuffer, width, height, id, ms, work}, {error: text}.
"use strict";

// From a disk the page has put rye.js before this.
if (typeof ryeModule === "undefined") importScripts("rye.js");

let rye = null, ready = null;

const floats = (at, count) => Array.from(new Float32Array(rye.HEAPF32.buffer, at, count));
const write = (at, values) => new Float32Array(rye.HEAPF32.buffer, at, values.length).set(values);
const check = (status) => {
    if (status !== 0) throw new Error(rye.UTF8ToString(rye._page_message()));
};

function open(buffer, name) {
    const bytes = new Uint8Array(buffer), at = rye._malloc(bytes.length);
    const text = rye._malloc(4 * name.length + 1);
    rye.stringToUTF8(name, text, 4 * name.length + 1);
    rye.HEAPU8.set(bytes, at);
    try {
        check(rye._page_open(text, at, bytes.length));
    } finally {
        rye._free(at);
        rye._free(text);
    }
    const n = rye._page_expressions();
    const names = [];
    for (let i = 0; i < n; ++i) names.push(rye.UTF8ToString(rye._page_expression_name(i)));
    return {
        name: rye.UTF8ToString(rye._page_name()),
        gaussians: rye._page_gaussians(),
        names,
        expression: floats(rye._page_expression(), n),
        low: floats(rye._page_expression_low(), n),
        high: floats(rye._page_expression_high(), n),
        gaze: floats(rye._page_gaze(), 4),
        gazeLow: floats(rye._page_gaze_low(), 4),
        gazeHigh: floats(rye._page_gaze_high(), 4),
        pose: floats(rye._page_pose(), 6),
        scale: rye._page_scale(),
        eyes: floats(rye._page_eyes(), 6),
        head: floats(rye._page_head(), 3),
        radius: rye._page_radius(),
        motion: floats(rye._page_motion(), 16),
        lens: floats(rye._page_lens(), 4),
        width: rye._page_width(),
        height: rye._page_height(),
    };
}

function draw(wanted) {
    if (wanted.gaze) write(rye._page_gaze(), wanted.gaze);
    if (wanted.expression) write(rye._page_expression(), wanted.expression);
    if (wanted.pose) write(rye._page_pose(), wanted.pose);
    if (wanted.motion) write(rye._page_motion(), wanted.motion);
    if (wanted.lookAt) check(rye._page_look(...wanted.lookAt));
    check(rye._page_size(wanted.width, wanted.height));
    const begin = performance.now();
    check(rye._page_draw(wanted.idle ?? -1, 0.5));
    const ms = performance.now() - begin;
    const work = rye._page_work() >> 2;
    const at = rye._page_pixels(), size = 4 * wanted.width * wanted.height;
    return {
        picture: rye.HEAPU8.slice(at, at + size).buffer,
        width: wanted.width,
        height: wanted.height,
        ms,
        work: { gaussians: rye.HEAP32[work], tiles: rye.HEAP32[work + 1], pixels: rye.HEAP32[work + 2] },
    };
}

onmessage = async ({ data }) => {
    try {
        if ("start" in data)
            ready = ryeModule(data.start ? { wasmBinary: data.start } : {}).then((module) => { rye = module; });
        await ready;
        if (data.open) postMessage({ opened: open(data.open, data.name) });
        if (data.draw) {
            const drawn = draw(data.draw);
            drawn.id = data.id;
            postMessage(drawn, [drawn.picture]);
        }
    } catch (fault) {
        postMessage({ error: String(fault.message || fault), id: data.id });
    }
};
