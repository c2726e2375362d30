// SPDX-License-Identifier: Apache-2.0
// judge_test.js WORK: what benchmarks/judge computes beside its models: offsets of irises, gazes and their
// calibration, differences of faces, means, the reader of labels, and the reader of evaluations.
"use strict";

const assert = require("node:assert");
const fs = require("node:fs");
const path = require("node:path");
const zlib = require("node:zlib");
const m = require("../../benchmarks/judge/measures.js");
const { gazesOf, numbers, unzipped } = require("../../benchmarks/judge/labels.js");
const { evaluation, identityDistance, judged, judgement, own } = require("../../benchmarks/judge/evaluations.js");

const work = process.argv[2];
const near = (x, y, bound = 1e-9) => assert.ok(Math.abs(x - y) <= bound, `${x}, expected ${y}`);
const all_near = (a, b, bound) => {
    assert.strictEqual(a.length, b.length);
    a.forEach((x, i) => near(x, b[i], bound));
};

/// A face that looks to the camera: eyes 40 pixels wide, their middles 120 apart, irises by offsets.
function face({ left = [0, 0], right = [0, 0], blink = [0, 0], yaw = 0, other = {} } = {}) {
    const landmarks = Array.from({ length: 478 }, (_, i) => [300 + (i % 20), 250 + (i % 31)]);
    landmarks[362] = [400, 300], landmarks[263] = [440, 300];  // the subject's left is at the right
    landmarks[133] = [320, 300], landmarks[33] = [280, 300];
    landmarks[473] = [420 + 40 * left[0], 300 - 40 * left[1]];
    landmarks[468] = [300 - 40 * right[0], 300 - 40 * right[1]];
    const coefficients = { eyeBlinkLeft: blink[0], eyeBlinkRight: blink[1] };
    for (let i = 2; i < 52; ++i) coefficients[`other${i}`] = 0.5;
    Object.assign(coefficients, other);
    const s = Math.sin((yaw * Math.PI) / 180), c = Math.cos((yaw * Math.PI) / 180);
    return { landmarks, coefficients, matrix: [c, 0, s, 0, 0, 1, 0, 0, -s, 0, c, 0, 0, 0, -50, 1] };
}

// ---- offsets, camera, gaze -----------------------------------------------------------------------
const [left, right] = m.eyes;
const looking = face({ left: [0.2, 0.1], right: [-0.15, 0.05] });
all_near(m.irisOffset(looking, left), [0.2, 0.1]);
all_near(m.irisOffset(looking, right), [-0.15, 0.05]);
const turn = ([x, y]) => [3 * (0.8 * x - 0.6 * y), 3 * (0.6 * x + 0.8 * y)];
const turned = { ...looking, landmarks: looking.landmarks.map(turn) };
all_near(m.irisOffset(turned, left), [0.2, 0.1]);
all_near(m.irisOffset(turned, right), [-0.15, 0.05]);
const looks = { eyeLookOutRight: 0.7, eyeLookInRight: 0.1, eyeLookUpRight: 0.2, eyeLookDownRight: 0.5 };
all_near(m.lookOffset(face({ other: looks }), right), [0.6, -0.3]);
all_near(m.cameraAngles(face({ yaw: 30 })), [30, 0]);
near(m.offAxis([30, 0]), 30);
near(m.angle([0, 0], [90, 0]), 90);
near(m.angle([10, 0], [10, 0.001]), 0.001);
near(m.angle([0, 90], [77, 90]), 0);

const known = [[0.03, 0.05], [0.007, -0.0004], [0.0005, 0.0026], [-0.003, 0.0002], [0.0001, -0.0015]];
const offset = (eye, gaze, camera, k) => known[0][k] + known[1][k] * eye.sign * gaze[0] + known[2][k] * gaze[1]
    + known[3][k] * eye.sign * camera[0] + known[4][k] * camera[1];
const samples = [];
for (let i = 0; i < 24; ++i) {
    const eye = m.eyes[i % 2], gaze = [(i * 7) % 41 - 20, (i * 5) % 23 - 11];
    const camera = [(i * 3) % 17 - 8, (i * 11) % 19 - 9];
    samples.push({ eye, gaze, camera, offset: [0, 1].map((k) => offset(eye, gaze, camera, k)) });
}
for (const s of samples) all_near(m.gazeOf(s.offset, s.eye, s.camera, known), s.gaze, 1e-9);
m.calibrated(samples).forEach((row, i) => all_near(row, known[i], 1e-12));
assert.throws(() => m.calibrated(samples.slice(0, 9)), /9 open eyes to calibrate by/);

// ---- pictures of one view ------------------------------------------------------------------------
const same = m.compared([looking, looking, looking], 0);
assert.deepStrictEqual(same, { found: [true, true], landmarks: 0, irises: [0, 0], gaze: [0, 0],
                               gaze_at_rest: [0, 0], blink: 0, coefficients: 0, identity: 0 });
const moved = m.compared([face(), face({ left: [0.1, 0], blink: [0.26, 0] }), face({ right: [0, 0.05] })]);
all_near(moved.irises, [10, 0]);
near(moved.landmarks, (100 * 4) / 120 / 478);
near(moved.blink, 0.13);
near(moved.coefficients, 0.26 / 52);
assert.ok(!("identity" in moved));
const yaw_of = (x, y, eye) => m.gazeOf([x, y], eye, [0, 0], m.irisCalibration);
near(moved.gaze[0], m.angle(yaw_of(0, 0, left), yaw_of(0.1, 0, left)));
assert.ok(moved.gaze[0] > 10 && moved.gaze[0] < 20, `${moved.gaze[0]} degrees of a tenth of an eye's width`);
near(moved.gaze[1], 0);
near(moved.gaze_at_rest[0], 0);
near(moved.gaze_at_rest[1], m.angle(yaw_of(0, 0, right), yaw_of(0, 0.05, right)));
// The judge's own scatter, where it was asked for.
assert.ok(!("gaze_moved" in moved));
const scatter = m.compared([face(), face(), face(), face({ left: [0.1, 0] })]);
all_near(scatter.gaze_moved, [moved.gaze[0], 0]);
near(m.averaged([scatter]).gaze.moved, moved.gaze[0] / 2);
// The head is where the photograph shows it.
near(m.compared([face(), face({ yaw: 15 }), face()]).gaze[0], 0);
// Closed on the photograph: no iris. From the side: no gaze. No face: what `missed` says, or nothing.
assert.strictEqual(m.compared([face({ blink: [0.5, 0] }), face(), face()]).irises.length, 1);
const side = m.compared([face({ yaw: 25 }), face(), face()]);
assert.deepStrictEqual([side.irises.length, side.gaze], [2, []]);
const lost = m.compared([face(), null, null], 1);
assert.deepStrictEqual(lost, { found: [true, false], landmarks: 100, irises: [50, 50], gaze: [90, 90],
                               gaze_at_rest: [90, 90], blink: 1, coefficients: 1, identity: 1 });
assert.deepStrictEqual(m.compared([null, face(), face()], null), { found: [false, true], identity: null });

// ---- means ---------------------------------------------------------------------------------------
const mean = m.averaged([lost, same, side, m.compared([null, face(), face()], null)]);
assert.deepStrictEqual(mean.faces, { photograph: 3, render: 3 });
near(mean.landmarks, 100 / 3);
near(mean.gaze.degrees, 45);  // of four eyes: none of the view from the side
assert.strictEqual(mean.gaze.eyes, 4);
near(mean.irises, 100 / 6);
near(mean.identity, 0.5);
const none = m.averaged([m.compared([null, null, null])]);
assert.deepStrictEqual([none.landmarks, none.gaze.degrees, none.identity], [null, null, null]);
near(m.correlation([[1, 2], [2, 4], [3, 6]]), 1);
near(m.correlation([[1, 1], [2, 3], [3, 2]]), 0.5);
assert.strictEqual(m.correlation([[1, 1], [2, 1], [3, 1]]), null);
near(identityDistance([[0, 3, 0], [4, 3, 0]]), 4);
assert.deepStrictEqual([identityDistance([[0], null]), identityDistance([null, [0]])], [1, null]);

// ---- labels --------------------------------------------------------------------------------------
function npy(values, kind) {
    const header = `{'descr': '${kind}', 'fortran_order': False, 'shape': (${values.length},), }\n`;
    const data = Buffer.alloc(values.length * Number(kind[2]));
    values.forEach((x, i) => (kind === "<f4" ? data.writeFloatLE(x, 4 * i) : data.writeDoubleLE(x, 8 * i)));
    const begin = Buffer.from("\x93NUMPY\x01\x00\x00\x00", "latin1");
    begin.writeUInt16LE(header.length, 8);
    return Buffer.concat([begin, Buffer.from(header, "latin1"), data]);
}
function zip(files) {
    const parts = [], directory = [];
    let at = 0;
    for (const [name, bytes, method] of files) {
        const data = method === 8 ? zlib.deflateRawSync(bytes) : bytes;
        const local = Buffer.alloc(30), entry = Buffer.alloc(46);
        local.writeUInt32LE(0x04034b50, 0), local.writeUInt16LE(name.length, 26);
        entry.writeUInt32LE(0x02014b50, 0), entry.writeUInt16LE(method, 10);
        entry.writeUInt32LE(data.length, 20), entry.writeUInt32LE(bytes.length, 24);
        entry.writeUInt16LE(name.length, 28), entry.writeUInt32LE(at, 42);
        parts.push(local, Buffer.from(name), data), directory.push(entry, Buffer.from(name));
        at += 30 + name.length + data.length;
    }
    const end = Buffer.alloc(22), listed = Buffer.concat(directory);
    end.writeUInt32LE(0x06054b50, 0), end.writeUInt16LE(files.length, 10);
    end.writeUInt32LE(listed.length, 12), end.writeUInt32LE(at, 16);
    return Buffer.concat([...parts, listed, end]);
}
const up = [0, Math.sin(0.2), Math.cos(0.2)], aside = [Math.sin(-0.3), 0, Math.cos(-0.3)];
const params = path.join(work, "capture/params/0007");
fs.mkdirSync(params, { recursive: true });
const labels = zip([["gaze_left.npy", npy(up, "<f4"), 8], ["gaze_right.npy", npy(aside, "<f8"), 0]]);
fs.writeFileSync(path.join(params, "gaze.npz"), labels);
const gazes = gazesOf(path.join(work, "capture"), "0007");
all_near(gazes[0], [0, (0.2 * 180) / Math.PI], 1e-5);
all_near(gazes[1], [(-0.3 * 180) / Math.PI, 0], 1e-9);
fs.writeFileSync(path.join(params, "gaze.npz"), zip([["gaze_left.npy", npy([1, 1, 1], "<f4"), 8]]));
assert.throws(() => gazesOf(path.join(work, "capture"), "0007"),
              /gaze\.npz: gaze_left: got \[1,1,1\], expected a unit vector/);
assert.throws(() => unzipped(labels.subarray(0, 90), "a.npz"), /a\.npz: is no zip archive/);
assert.throws(() => unzipped(zip([["a", Buffer.from("a"), 12]]), "a.npz"), /a\.npz: a: compression 12/);
assert.throws(() => numbers(undefined, "a.npz: b"), /a\.npz: b: is no \.npy file/);
const integers = npy([1], "<f8").map((x) => (x === 0x66 ? 0x69 : x));  // each f an i
assert.throws(() => numbers(integers, "b"), /b: got .*expected float32 or float64/);

// ---- an evaluation -------------------------------------------------------------------------------
const folder = path.join(work, "evaluation"), pictures = path.join(folder, "evaluate_test");
fs.mkdirSync(pictures, { recursive: true });
const line = (frame, groups, degrees) => ({
    frame, camera: "08", picture: `frame_${frame}.png`, groups, eyes_visible: 2,
    gaze: { render: { degrees }, at_rest: { degrees: 20 } } });
fs.writeFileSync(path.join(folder, "results.json"), JSON.stringify({ split: "test" }));
fs.writeFileSync(path.join(folder, "per_view.json"), JSON.stringify([
    line("1", ["novel gaze"], 1), line("2", ["independent eyes"], 3), { frame: "2", camera: "00" }]));
assert.throws(() => evaluation(folder), /frame_1\.png: is missing/);
for (const frame of ["1", "2"]) fs.writeFileSync(path.join(pictures, `frame_${frame}.png`), "");
const read = evaluation(folder), [first, second] = read.views.map((v) => v.file);
assert.strictEqual(read.views.length, 2);
const faces = { [first]: [face(), face({ left: [0.1, 0] }), face()],
                [second]: [face({ yaw: 25 }), face(), null] };
const out = judged(read, faces, null, ["identity: no"]);
assert.deepStrictEqual(Object.keys(out),
                       ["not_run", "split", "all", "novel gaze", "independent eyes", "views"]);
near(out.all.irises, 10 / 4);
near(out["novel gaze"].irises, 5);
assert.strictEqual(out["independent eyes"].gaze.degrees, null);
assert.strictEqual(out.all.identity, null);
assert.deepStrictEqual(own(read.views, out), { degrees: 1, at_rest: 20 });  // where the judge sees a gaze
const named = judged(read, faces, { [first]: [[0, 0], [0, 2]], [second]: [[1], null] }, []);
near(named.all.identity, 1.5);

/// A model that answers in turn, of as many parts as it is asked for.
function model(answers) {
    const all = [...answers];
    return { faces: async (parts) => all.shift().slice(0, Number(/(\d)\)$/.exec(parts)[1])), left: () => all.length };
}
async function files() {
    const written = () => JSON.parse(fs.readFileSync(path.join(folder, "judge.json"), "utf8"));
    assert.strictEqual(await judgement(read, {}, []), null);
    const models = { faces: model([faces[first], faces[second]]) };
    const told = await judgement(read, models, ["identity: no"]);
    assert.deepStrictEqual(told, written());
    assert.deepStrictEqual(told, JSON.parse(JSON.stringify(out)));
    // What is there is kept, unless a model runs that did not.
    assert.deepStrictEqual(await judgement(read, {}, []), told);
    assert.deepStrictEqual(await judgement(read, { faces: model([]) }, ["identity: no", "more: no"]), told);
    const both = { faces: model([faces[first], faces[second]]), identities: model([[[0, 0], [0, 2]], [[1], null]]) };
    near((await judgement(read, both, [])).all.identity, 1.5);
    assert.strictEqual(both.faces.left() + both.identities.left(), 0);
    assert.deepStrictEqual(await judgement(read, { faces: model([]) }, ["identity: no"]), written());
    assert.deepStrictEqual(fs.readdirSync(folder).sort(),
                           ["evaluate_test", "judge.json", "per_view.json", "results.json"]);
    fs.writeFileSync(path.join(folder, "per_view.json"), "[");
    assert.throws(() => evaluation(folder), /per_view\.json: /);
}
files().then(() => console.log("judge_test: passed"), (e) => {
    console.error(e);
    process.exit(1);
});
