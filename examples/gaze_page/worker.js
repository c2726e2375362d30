// SPDX-License-Identifier: Apache-2.0
// worker.js: rye in a thread of its own, so that the page stays responsive. Messages in:
//   {start: ArrayBuffer or null, by, threads}   the first: rye.wasm, or that it is to be read from the host.
//     `by`: "wasm"; "webgpu", of software too; otherwise WebGPU once it is ready, where it is hardware.
//     `threads`: at most so many, where the page is cross-origin isolated; without it one for each processor
//   {open: ArrayBuffer, name}           an avatar file
//   {draw: {gaze, expression, pose, motion, background, width, height}, id}   any of these; the rest
//     stays. With `lookAt`, a point of the world, both eyes look there; with `idle`, seconds, they
//     live by themselves, in this picture alone
//   {aim: {point, pose, expression}, id}   at which angles would the eyes of such a head look at this point
//     of the world?
// Messages out: {opened: {...}}, {aimed: left pitch, yaw, right pitch, yaw [rad], or null, id},
// {picture: ArrayBuffer, width, height, id, ms, work, by, note, threads}, {error: text}. `by` says what drew it, `note` why that is not WebGPU, `threads` how many WebAssembly has.
"use strict";

let rye = null, by = "auto", threads = 1;
let memory = null;      // that threads share
let drawing = null;     // by WebGPU
let note = "";          // why there is none
let opened = 0;         // avatars

const buffer = () => (memory ?? rye.HEAPU8).buffer;  // another thread may have made the memory grow
const here = (at, count) => new Float32Array(buffer(), at, count);
const floats = (at, count) => Array.from(here(at, count));
const integers = (at, count) => Array.from(new Int32Array(buffer(), at, count));
const write = (at, values) => here(at, values.length).set(values);
const check = (status) => {
    if (status !== 0) throw new Error(rye.UTF8ToString(rye._page_message()));
};

/// The module of several threads; rejects where one of them does not start, or all take long.
async function loadThreads(count) {
    importScripts("rye_threads.js");
    memory = new WebAssembly.Memory({ initial: 1024, maximum: 32768, shared: true });  // as build.sh links it
    const begun = [], Plain = self.Worker;
    let reject;
    const failed = new Promise((_, no) => { reject = no; });
    const late = setTimeout(() => reject(new Error("threads did not start")), 20000);
    const fail = (event) => {
        event.preventDefault();
        event.stopImmediatePropagation();  // emscripten would throw it where nothing can catch it
        reject(event);
    };
    self.Worker = class extends Plain {
        constructor(...of) {
            super(...of);
            this.addEventListener("error", fail);
            begun.push(this);
        }
    };
    try {
        const module = await Promise.race([failed, ryeThreadsModule({ threads: count, wasmMemory: memory,
            printErr() {}, mainScriptUrlOrBlob: new URL("rye_threads.js", location.href).href })]);
        for (const worker of begun) worker.removeEventListener("error", fail);
        return module;
    } catch (fault) {
        for (const worker of begun) worker.terminate();
        throw fault;
    } finally {
        clearTimeout(late);
        self.Worker = Plain;
    }
}

/// Loads the module of several threads where the page may have them, else that of one. From a disk the
/// page has put rye.js, and webgpu.js, before this, and `binary` is rye.wasm.
async function load(binary, most) {
    const count = Math.min(most ?? Math.min(navigator.hardwareConcurrency || 1, 8), 32);
    if (!binary && self.crossOriginIsolated && count > 1) {
        try {
            rye = await loadThreads(count);
            threads = count;
            return;
        } catch {
            memory = null;  // one thread draws the same
        }
    }
    if (typeof ryeModule === "undefined") importScripts("rye.js");
    rye = await ryeModule(binary ? { wasmBinary: binary } : {});
}

async function open(file, name) {
    const bytes = new Uint8Array(file), at = rye._malloc(bytes.length);
    const text = rye._malloc(4 * name.length + 1);
    rye.stringToUTF8(name, text, 4 * name.length + 1);
    new Uint8Array(buffer()).set(bytes, at);
    drawing?.close();
    drawing = null;
    try {
        check(rye._page_open(text, at, bytes.length, threads));
    } finally {
        rye._free(at);
        rye._free(text);
    }
    const begun = begin(++opened);
    if (by === "webgpu") await begun;
    const n = rye._page_expressions();
    const names = [];
    for (let i = 0; i < n; ++i) names.push(rye.UTF8ToString(rye._page_expression_name(i)));
    return {
        name: rye.UTF8ToString(rye._page_name()),
        gaussians: rye._page_gaussians(),
        channels: shapeOfNetwork().channels,
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

// ---- WebGPU -------------------------------------------------------------------------------------
function shapeOfNetwork() {
    const [channels, capacity, doublings, normalized, skip] = integers(rye._page_network(), 5);
    return { channels, capacity, doublings, normalized, skip };
}

/// Makes a drawing for the avatar that is open; pictures are WebAssembly's until it is there.
async function begin(avatar) {
    if (by === "wasm") return;
    try {
        if (typeof RyeDrawing === "undefined") importScripts("webgpu.js");
        const s = shapeOfNetwork(), outputs = (l) => s.capacity << (s.doublings - (l >> 1));
        const inputs = (l) => (l === 0 ? s.channels : outputs(l - 1));
        const convolution = Array.from({ length: 2 * (s.doublings + 1) }, (_, l) =>
            Float32Array.from(here(rye._page_convolution(l), 9 * inputs(l) * outputs(l))));
        const network = { ...s, convolution, outWeight: floats(rye._page_out_weight(), 3 * s.capacity),
                          outBias: floats(rye._page_out_bias(), 3) };
        const made = await RyeDrawing.make({ gaussians: rye._page_gaussians(), network,
                                             software: by === "webgpu" });
        if (avatar !== opened) return made.close();  // another file since
        drawing = made;
        note = "";
    } catch (fault) {
        if (avatar === opened) note = fault.message;
    }
}

/// What drawing.js draws, at an accuracy of rye_accuracy; views of the module's memory.
function frame(width, height, accuracy = 0) {
    const n = rye._page_gaussians(), { channels } = shapeOfNetwork();
    const [fx, fy, cx, cy, near, w, h] = floats(rye._page_render_lens(), 7);
    const [alphaMin, alphaMax, stop, margin] = floats(rye._page_rules(accuracy), 4);
    return {
        cloud: {
            mean: here(rye._page_mean(), 3 * n),
            rotation: here(rye._page_rotation(), 4 * n),
            scale: here(rye._page_gaussian_scale(), 3 * n),
            opacity: here(rye._page_opacity(), n),
            feature: here(rye._page_feature(), channels * n),
            moves: rye._page_moves(),
        },
        camera: { motion: floats(rye._page_motion(), 16), fx, fy, cx, cy, near, width: w, height: h },
        rules: { alphaMin, alphaMax, stop, dilation: rye._page_dilation(), margin },
        background: here(rye._page_background(), channels),
        width, height,
    };
}

/// The picture by WebGPU; null where it fails, which ends it.
async function byWebGpu(idle, width, height) {
    check(rye._page_drive(idle, 0.5));
    try {
        return await drawing.draw(frame(width, height));
    } catch (fault) {
        drawing.close();
        drawing = null;
        note = fault.message;
        return null;
    }
}

function byWasm(idle, width, height) {
    check(rye._page_draw(idle, 0.5));
    const at = rye._page_pixels();
    return new Uint8Array(buffer(), at, 4 * width * height).slice().buffer;
}

function aim({ point, pose, expression }) {
    const places = [rye._page_pose(), rye._page_expression()];
    const kept = [floats(places[0], 6), floats(places[1], rye._page_expressions())];
    write(places[0], pose);
    write(places[1], expression);
    const at = rye._page_aim(...point), angles = at === 0 ? null : floats(at, 4);
    kept.forEach((values, i) => write(places[i], values));
    return angles;
}

async function draw(wanted) {
    if (wanted.gaze) write(rye._page_gaze(), wanted.gaze);
    if (wanted.expression) write(rye._page_expression(), wanted.expression);
    if (wanted.pose) write(rye._page_pose(), wanted.pose);
    if (wanted.motion) write(rye._page_motion(), wanted.motion);
    if (wanted.background) {
        const { channels } = shapeOfNetwork(), { length } = wanted.background;
        if (length !== channels || !wanted.background.every(Number.isFinite))
            throw new Error(`background: got ${length} numbers, expected ${channels} that are finite`);
        write(rye._page_background(), wanted.background);
    }
    if (wanted.lookAt) check(rye._page_look(...wanted.lookAt));
    check(rye._page_size(wanted.width, wanted.height));
    const { idle = -1, width, height } = wanted;
    const begun = performance.now();
    let picture = drawing && await byWebGpu(idle, width, height);
    const gpu = Boolean(picture);
    picture ||= byWasm(idle, width, height);
    const ms = performance.now() - begun;
    const [gaussians, tiles, pixels] = integers(rye._page_work(), 3);
    const work = gpu ? { gaussians, tiles: drawing.splats.tiles, pixels: width * height }
                     : { gaussians, tiles, pixels };
    return { picture, width, height, ms, by: gpu ? "webgpu" : "wasm", note, threads, work };
}

async function act(data) {
    try {
        if ("start" in data) {
            by = data.by ?? "auto";
            await load(data.start, data.threads);
        }
        if (!rye) throw new Error("rye could not start");
        if (data.open) postMessage({ opened: await open(data.open, data.name) });
        if (data.aim) postMessage({ aimed: aim(data.aim), id: data.id });
        if (data.draw) {
            const drawn = await draw(data.draw);
            drawn.id = data.id;
            postMessage(drawn, [drawn.picture]);
        }
    } catch (fault) {
        postMessage({ error: String(fault.message || fault), id: data.id });
    }
}

// One after another: a picture may have to wait for the device.
let queue = Promise.resolve();
onmessage = ({ data }) => { queue = queue.then(() => act(data)); };
