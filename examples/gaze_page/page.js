// SPDX-License-Identifier: Apache-2.0
// page.js: the controls. The page keeps what is wanted (gaze, expression, pose, camera, size); one
// picture at a time is asked of the worker, which computes what differs from the one before. `rye view`
// puts a worker of its own before this script, window.ryeRemote, which asks the program.
"use strict";

const element = (id) => document.getElementById(id);
const canvas = element("picture");
const context = canvas.getContext("2d", { alpha: false });
const options = new URLSearchParams(location.search);  // ?avatar=FILE, ?draw=wasm or webgpu, ?threads=MOST
let worker = null;      // from start() on
const degrees = 180 / Math.PI;
const clamp = (x, low, high) => Math.min(high, Math.max(low, x));

let avatar = null;      // what the worker says of the file
let orbit = null;
let wanted = {};        // of the next picture: parts that changed
let busy = false;
const sides = window.ryeRemote ? [256, 512, 768, 1024] : [256, 384, 512];
let side = 256;
let pointer = null;     // [-1, 1] across and up the stage, where the eyes look
let gaze = [0, 0, 0, 0], goal = [0, 0, 0, 0];  // left pitch, yaw, right pitch, yaw [rad]
let goals = 0;          // those that no pointer set: an answer to a question from before is too late
let expression = [], turn = [0, 0, 0];         // turn: yaw, pitch, roll of the head [rad]
let pictures = 0, waiting = [];
let lately = [];        // times of the last pictures [ms]
const begun = performance.now();

// ---- small rotations, rows ------------------------------------------------------------------------
const product = (a, b) => a.map((row) => [0, 1, 2].map((j) =>
    row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
const times = (a, v) => a.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const transposed = (a) => [0, 1, 2].map((i) => [a[0][i], a[1][i], a[2][i]]);
const plus = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);

function rotation(v) {  // exp of an axis-angle
    const angle = Math.hypot(...v);
    const [x, y, z] = angle < 1e-9 ? [0, 0, 0] : v.map((c) => c / angle);
    const s = Math.sin(angle), c = Math.cos(angle), d = 1 - c;
    return [[c + d * x * x, d * x * y - s * z, d * x * z + s * y],
            [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
            [d * x * z - s * y, d * y * z + s * x, c + d * z * z]];
}
function axisAngle(r) {  // below half a turn
    const v = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]];
    const s = Math.hypot(...v) / 2, c = (r[0][0] + r[1][1] + r[2][2] - 1) / 2;
    const angle = Math.atan2(s, c);
    return s < 1e-9 ? [0, 0, 0] : v.map((x) => (x * angle) / (2 * s));
}

/// The head's pose after its sliders: turned about the middle of the head.
function pose() {
    const neutral = avatar.pose;
    if (turn.every((a) => a === 0)) return neutral;
    const [yaw, pitch, roll] = turn, r0 = rotation(neutral.slice(0, 3));
    const more = product(product(rotation([0, yaw, 0]), rotation([-pitch, 0, 0])),
                         rotation([0, 0, roll]));
    const r = product(r0, more);
    const middle = times(transposed(r0), plus(avatar.head, neutral.slice(3), -1));
    return [...axisAngle(r), ...plus(avatar.head, times(r, middle), -1)];
}

/// The angles at which both eyes look at a point: to the right of the middle of the head as the page shows
/// it, above, and before it. The worker finds them.
const questions = new Map();
let asked = 0;
function gazeTo([across, up, before]) {
    const [right, above, toward] = orbit.axes();
    const point = plus(plus(plus(avatar.head, toward, before), right, across), above, up);
    return new Promise((answer) => {
        questions.set(++asked, answer);
        worker.postMessage({ aim: { point, pose: pose(), expression }, id: asked });
    });
}
function hearGaze({ aimed, id }) {
    const angles = aimed ?? gaze;  // a point in an eye moves none
    questions.get(id)([0, 1].flatMap((eye) => within(eye, angles[2 * eye], angles[2 * eye + 1])));
    questions.delete(id);
}
/// Those at a point that the pointer shows, on a screen where a visitor would be, which spans 60 degrees:
/// eyes turn in by some 6.
function gazeAt([across, up]) {
    const half = 3 * avatar.radius;
    return gazeTo([half * across, half * up, 5.2 * avatar.radius]);
}
/// Angles clamped to the ranges of the training frames.
const within = (eye, pitch, yaw) =>
    [clamp(pitch, avatar.gazeLow[2 * eye], avatar.gazeHigh[2 * eye]),
     clamp(yaw, avatar.gazeLow[2 * eye + 1], avatar.gazeHigh[2 * eye + 1])];

// ---- pictures -----------------------------------------------------------------------------------
function want(parts) {
    Object.assign(wanted, parts);
    ask();
}

function ask() {
    if (busy || !avatar || Object.keys(wanted).length === 0) return;
    busy = true;
    if (wanted.idle === undefined) state.lives = false;
    const draw = { ...wanted, width: side, height: Math.round((side * avatar.height) / avatar.width) };
    wanted = {};
    worker.postMessage({ draw, id: ++pictures });
}

function show(drawn) {
    if (canvas.width !== drawn.width || canvas.height !== drawn.height) {
        canvas.width = drawn.width;
        canvas.height = drawn.height;
    }
    if (drawn.bitmap) context.drawImage(drawn.bitmap, 0, 0);
    else context.putImageData(new ImageData(new Uint8ClampedArray(drawn.picture), drawn.width, drawn.height), 0, 0);
    element("poster")?.remove();
    state.frames += 1;
    state.last = { ms: drawn.ms, work: drawn.work, by: drawn.by, note: drawn.note, threads: drawn.threads };
    if (state.firstPicture === null) state.firstPicture = performance.now() - begun;
    lately = [...lately.slice(-14), drawn.ms];
    const middle = [...lately].sort((a, b) => a - b)[lately.length >> 1];
    element("ms").textContent = `${middle.toFixed(1)} ms`;
    element("moved").textContent = `${Math.round((100 * drawn.work.gaussians) / avatar.gaussians)} %`;
    element("redrawn").textContent =
        `${Math.round((100 * drawn.work.pixels) / (drawn.width * drawn.height))} %`;
    const kinds = { webgpu: "WebGPU", wasm: drawn.threads > 1 ? `WebAssembly, ${drawn.threads} threads` : "WebAssembly" };
    element("by").textContent = kinds[drawn.by] ? kinds[drawn.by] + (drawn.note ? `: ${drawn.note}` : "") : "rye view";
    notice("");
}

function notice(text, fault = false) {
    element("notice").textContent = text;
    element("notice").classList.toggle("fault", fault);
}

function hear({ data }) {
    if (data.error) {
        notice(data.error, true);
        state.errors.push(data.error);
        busy = false;
        for (const w of waiting.splice(0)) w.reject(new Error(data.error));
        return ask();
    }
    if (data.opened) return begin(data.opened);
    if (data.aimed !== undefined) return hearGaze(data);
    busy = false;
    show(data);
    const done = waiting.filter((w) => w.id <= data.id);
    waiting = waiting.filter((w) => w.id > data.id);
    for (const w of done) w.resolve(state.last);
    ask();
}

function start(address, wasm = null) {
    worker = new Worker(address);
    worker.onmessage = hear;
    worker.onerror = (fault) => {
        notice(`The page could not start: ${fault.message || "WebAssembly with SIMD is needed"}`, true);
        state.errors.push(String(fault.message));
    };
    const by = options.get("draw"), threads = options.get("threads");
    worker.postMessage({ start: wasm, by: by ?? "auto", threads: threads === null ? undefined : Number(threads) });
    if (![null, "wasm", "webgpu"].includes(by)) throw new Error(`?draw: got ${by}, expected wasm or webgpu`);
    if (threads !== null && !/^[1-9]\d?$/.test(threads))
        throw new Error(`?threads: got ${threads}, expected a number from 1 on`);
}

/// Eyes move to their goal in a few pictures, as eyes do, and end exactly there. Where nobody has moved
/// anything for a while, they live by themselves.
let lastStep = 0, lastTouch = performance.now();
const patience = 2500, lifetime = 600;  // [ms]; [s], after which a life begins again
function touched() {
    lastTouch = performance.now();
}
function lives(now) {
    return avatar && element("alive").checked && now - lastTouch > patience && !document.hidden;
}
function step(now) {
    requestAnimationFrame(step);
    if (!avatar || busy) return;
    const share = 1 - Math.exp(-Math.min(now - lastStep, 100) / 45);
    lastStep = now;
    const left = Math.max(...gaze.map((g, i) => Math.abs(goal[i] - g)));
    if (left === 0) {
        if (lives(now)) {
            state.lives = true;
            want({ idle: ((now - lastTouch - patience) / 1000) % lifetime });
        } else if (state.lives) {  // what was drawn last is not what the page shows
            want({ gaze });
        }
        return;
    }
    gaze = left < 0.004 ? [...goal] : gaze.map((g, i) => g + share * (goal[i] - g));
    showGaze();
    want({ gaze });
}
requestAnimationFrame(step);

// ---- sliders ------------------------------------------------------------------------------------
function slider(parent, { name, low, high, value, unit = 1, digits = 0, suffix = "" }, input) {
    const label = document.createElement("label"), text = document.createElement("span");
    const range = document.createElement("input"), output = document.createElement("output");
    label.className = "slider";
    text.textContent = name;
    text.title = name;
    Object.assign(range, { type: "range", min: low, max: high, step: (high - low) / 400 || 0.01 });
    label.append(text, range, output);
    parent.append(label);
    const set = (v) => {
        range.value = v;
        output.textContent = `${(v * unit).toFixed(digits)}${suffix}`;
    };
    range.addEventListener("input", () => {
        touched();
        set(Number(range.value));
        input(Number(range.value));
    });
    set(value);
    return { set, label };
}

let eyeSliders = [], headSliders = [], expressionSliders = [];

function showGaze() {
    eyeSliders.forEach((s, i) => s.set(gaze[i]));
}

function makeSliders() {
    for (const id of ["eyes", "head", "expression", "sizes"]) element(id).replaceChildren();
    const angle = { unit: degrees, suffix: "°" };
    const names = ["Left, up", "Left, aside", "Right, up", "Right, aside"];
    eyeSliders = names.map((name, i) => slider(element("eyes"),
        { name, low: avatar.gazeLow[i], high: avatar.gazeHigh[i], value: gaze[i], ...angle }, (v) => {
            element("follow").checked = false;
            ++goals;
            goal = [...goal];
            goal[i] = v;
            if (!element("apart").checked) {  // the other eye takes the same angle
                const other = (i + 2) % 4;
                goal[other] = clamp(v, avatar.gazeLow[other], avatar.gazeHigh[other]);
            }
            gaze = [...goal];
            showGaze();
            want({ gaze });
        }));
    headSliders = ["Turn", "Nod", "Tilt"].map((name, i) => slider(element("head"),
        { name, low: -0.35, high: 0.35, value: 0, ...angle }, (v) => {
            turn[i] = Math.abs(v) < 0.004 ? 0 : v;
            want({ pose: pose() });
            follow();
        }));
    // Those of the widest ranges first.
    const shown = 6, range = (i) => avatar.high[i] - avatar.low[i];
    const order = expression.map((_, i) => i).sort((i, j) => range(j) - range(i));
    expressionSliders = [];
    order.forEach((i, place) => {
        const s = slider(element("expression"),
            { name: avatar.names[i] || `Coefficient ${i + 1}`, low: avatar.low[i],
              high: avatar.high[i], value: expression[i], digits: 2 }, (v) => {
                expression[i] = v;
                want({ expression });
            });
        s.label.style.display = place >= shown ? "none" : "";
        expressionSliders[i] = s;
    });
    const more = element("more");
    more.hidden = expression.length <= shown;
    more.onclick = () => {
        for (const s of expressionSliders) s.label.style.display = "";
        more.hidden = true;
    };
    for (const size of sides) {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = `${size}²`;
        button.setAttribute("aria-pressed", String(size === side));
        button.onclick = () => resize(size);
        element("sizes").append(button);
    }
}

function resize(size) {
    side = size;
    for (const b of element("sizes").children)
        b.setAttribute("aria-pressed", String(b.textContent === `${size}²`));
    want({ motion: orbit.motion() });
}

/// A face without expression, as far as the training had one, that looks at the visitor.
async function reset() {
    touched();
    orbit.reset();
    turn = [0, 0, 0];
    expression = avatar.expression.map((_, i) => clamp(0, avatar.low[i], avatar.high[i]));
    pointer = [0, 0];
    headSliders.forEach((s) => s.set(0));
    expressionSliders.forEach((s, i) => s.set(expression[i]));
    const before = ++goals, angles = await gazeAt(pointer);
    if (before === goals) goal = gaze = angles;
    showGaze();
    want({ gaze, expression, pose: pose(), motion: orbit.motion() });
}

// ---- pointer, fingers, keys ---------------------------------------------------------------------
let following = false, again = false;
async function follow() {
    if (!avatar || !pointer || !element("follow").checked) return;
    again = true;
    if (following) return;  // one question at a time
    following = true;
    while (again) {
        again = false;
        const before = goals, angles = await gazeAt(pointer);
        if (before === goals) goal = angles;
    }
    following = false;
}
function look(x, y) {
    touched();
    const box = canvas.getBoundingClientRect(), half = Math.min(box.width, box.height) / 2;
    pointer = [(x - box.left - box.width / 2) / half, -(y - box.top - box.height / 2) / half];
    follow();
}
function orbitBy(yaw, pitch, zoom = 1) {
    touched();
    orbit.turn(yaw, pitch);
    orbit.magnify(zoom);
    want({ motion: orbit.motion() });
    follow();
    element("hint").classList.add("gone");
}

const held = new Map();  // pointers on the stage that are down
const spread = () => {
    const [a, b] = [...held.values()];
    return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, apart: Math.hypot(a.x - b.x, a.y - b.y) || 1 };
};
canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    held.set(e.pointerId, { x: e.clientX, y: e.clientY });
    if (e.pointerType !== "mouse") look(e.clientX, e.clientY);
});
for (const end of ["pointerup", "pointercancel"])
    canvas.addEventListener(end, (e) => {
        held.delete(e.pointerId);
        canvas.classList.remove("turning");
    });
window.addEventListener("pointermove", (e) => {
    if (!avatar) return;
    const from = held.get(e.pointerId);
    if (from && e.pointerType === "mouse") {  // a drag turns the camera
        canvas.classList.add("turning");
        const size = canvas.getBoundingClientRect().width;
        orbitBy((2.4 * (e.clientX - from.x)) / size, (2.4 * (e.clientY - from.y)) / size);
        held.set(e.pointerId, { x: e.clientX, y: e.clientY });
    } else if (from && held.size === 2) {     // two fingers turn and zoom
        const before = spread();
        held.set(e.pointerId, { x: e.clientX, y: e.clientY });
        const after = spread(), size = canvas.getBoundingClientRect().width;
        orbitBy((2.4 * (after.x - before.x)) / size, (2.4 * (after.y - before.y)) / size,
                after.apart / before.apart);
    } else {
        if (from) held.set(e.pointerId, { x: e.clientX, y: e.clientY });
        if (e.pointerType === "mouse" || from) look(e.clientX, e.clientY);
    }
});
canvas.addEventListener("wheel", (e) => {
    e.preventDefault();
    if (avatar) orbitBy(0, 0, Math.exp(-e.deltaY / 800));
}, { passive: false });
canvas.addEventListener("keydown", (e) => {
    const keys = { ArrowLeft: [-0.08, 0], ArrowRight: [0.08, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08],
                   "+": [0, 0, 1.1], "-": [0, 0, 1 / 1.1] };
    if (!avatar || !keys[e.key]) return;
    e.preventDefault();
    orbitBy(...keys[e.key]);
});
const coarse = matchMedia("(pointer: coarse)").matches;
element("hint").textContent = coarse ? "Touch: the eyes look there. Two fingers turn and zoom."
                                     : "Move the pointer: the eyes follow. Drag to turn, scroll to zoom.";
setTimeout(() => element("hint").classList.add("gone"), 9000);
element("controls").open = Boolean(window.ryeRemote);
element("numbers").open = Boolean(window.ryeRemote);
element("alive").checked = !matchMedia("(prefers-reduced-motion: reduce)").matches;
element("follow").addEventListener("change", follow);
element("reset").addEventListener("click", () => avatar && reset());
element("file").addEventListener("change", async (e) => {
    const file = e.target.files[0];
    if (file) open(await file.arrayBuffer(), file.name);
});

// ---- files --------------------------------------------------------------------------------------
function open(buffer, name) {
    notice("Opening…");
    worker.postMessage({ open: buffer, name }, [buffer]);
}

function begin(opened) {
    avatar = opened;
    orbit = new Orbit(avatar.motion, avatar.head);
    gaze = goal = [...avatar.gaze];
    expression = [...avatar.expression];
    side = sides.includes(avatar.width) ? avatar.width : 256;
    makeSliders();
    element("facts").textContent =
        `${avatar.name ? `${avatar.name}, ` : ""}${avatar.gaussians.toLocaleString("en")} Gaussians`;
    canvas.setAttribute("aria-label", `${avatar.name || "A head"}. ` +
        "Its eyes follow the pointer; drag, or press the arrow keys, to turn the camera.");
    state.avatar = avatar;
    reset();
}

/// For scripts: what is shown, and a picture by drivers of their own.
const state = {
    frames: 0,
    last: null,
    firstPicture: null,  ///< [ms] from the start of this script
    errors: [],
    avatar: null,
    lives: false,        ///< the last picture is of eyes that live by themselves
    /// Shows gaze (left pitch, yaw, right pitch, yaw [rad]), expression, pose (6), motion (16), all
    /// optional, at width x width; resolves after it is on the canvas with its time and work.
    show(parts, width = side) {
        touched();
        side = width;
        if (parts.gaze) {
            ++goals;
            goal = gaze = [...parts.gaze];
        }
        return new Promise((resolve, reject) => {
            delete wanted.idle;
            Object.assign(wanted, parts.gaze ? {} : { gaze }, parts);
            waiting.push({ id: pictures + 1, resolve, reject });
            ask();
        });
    },
};
window.gazePage = state;

/// From a disk, where browsers let a page read no files but scripts: files.js has them.
async function fromDisk() {
    if (options.has("avatar")) throw new Error("an address with ?avatar= needs a web server");
    const script = document.createElement("script");
    script.src = "files.js";
    await new Promise((resolve, reject) => {
        script.onload = resolve;
        script.onerror = () => reject(new Error("no file files.js beside the page"));
        document.head.append(script);
    });
    const bytes = (name) => Uint8Array.from(atob(window.ryeFiles[name]), (c) => c.charCodeAt(0));
    const parts = ["rye.js", "webgpu.js", "worker.js"].flatMap((name) => [bytes(name), "\n"]);
    const scripts = new Blob(parts, { type: "text/javascript" });
    start(URL.createObjectURL(scripts), bytes("rye.wasm").buffer);
    if (!window.ryeFiles["head.avatar"]) throw new Error("the folder has none");
    open(bytes("head.avatar").buffer, "head.avatar");
}

async function fromHost() {
    start("worker.js");
    const name = options.get("avatar") || "head.avatar";
    const answer = await fetch(name);
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
    open(await answer.arrayBuffer(), name);
}

async function fromProgram() {
    worker = window.ryeRemote;
    worker.onmessage = hear;
    worker.postMessage({ open: null });
}

(window.ryeRemote ? fromProgram() : location.protocol === "file:" ? fromDisk() : fromHost()).catch((fault) =>
    notice(`No avatar yet (${fault.message}): open a file that \`rye export --out NAME.avatar\` wrote.`));
