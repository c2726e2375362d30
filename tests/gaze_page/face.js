// SPDX-License-Identifier: Apache-2.0
// face.js: what a tracked face means to an avatar (examples/gaze_page/face.js), by hand.
"use strict";

const assert = require("node:assert");
const Face = require("../../examples/gaze_page/face.js");

for (const name of ["browDown_L", "BrowDownLeft", "brow down left", "BROW_DOWN.l"])
    assert.deepStrictEqual(Face.sided(name), { base: "browdown", side: "l" }, name);
assert.deepStrictEqual(Face.sided("jawOpen"), { base: "jawopen", side: "" });

const tracked = ["_neutral", "jawOpen", "mouthSmileLeft", "mouthSmileRight", "cheekPuff"];
const from = Face.sources(tracked, ["JawOpen", "mouthSmile", "cheekPuff_L", "", "tongueOut"]);
assert.deepStrictEqual(from, [[[1, 1]], [[2, 0.5], [3, 0.5]], [[4, 1]], [], []]);
const ranges = { low: [0, 0, 0, -1, -1], high: [0.5, 1, 1, 1, 1] };
assert.deepStrictEqual(Face.expression(from, [0, 0.9, 0.2, 0.6, 0.3], ranges, [0.1, 0.1, 0.1, 0.4, -0.2]),
                       [0.5, 0.4, 0.3, 0.4, -0.2]);

const names = ["Up", "Down", "In", "Out"].flatMap((way) => ["Left", "Right"].map((eye) => `eyeLook${way}${eye}`));
const toLeft = names.map((name) => (["eyeLookOutLeft", "eyeLookInRight"].includes(name) ? 0.5 : 0));
const degrees = Face.gaze(names, toLeft).map((x) => Math.round((x * 180) / Math.PI) + 0);
assert.deepStrictEqual(degrees, [0, 20, 0, 20]);
assert.strictEqual(Face.gaze(tracked, [0, 0, 0, 0, 0]), null);

// 50 cm before the camera, at the upper end of its picture: 31.5 degrees up.
const landmarks = Array.from({ length: 478 }, () => ({ x: 0.75, y: 0 }));
const matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, -50, 1];
const [right, up, before] = Face.place(landmarks, matrix, 640, 480);
assert.ok(before === 50 && Math.abs(Math.atan2(up, before) - Face.halfField) < 1e-12);
assert.ok(Math.abs(right - (50 * 160 * Math.tan(Face.halfField)) / 240) < 1e-9);
console.log("names, expressions, gazes and places of a tracked face are right");
