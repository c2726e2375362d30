// SPDX-License-Identifier: Apache-2.0
// labels.js: the gazes of a capture's frames (gaze.npz, docs/capture_format.md).
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const zlib = require("node:zlib");

/// Returns the files of a zip archive, stored or deflated, by name. Throws an Error that names the file.
function unzipped(bytes, who) {
    const wrong = (what) => new Error(`${who}: ${what}`);
    const end = bytes.lastIndexOf(Buffer.from("PK\x05\x06", "latin1"));
    if (end < 0 || end + 22 > bytes.length) throw wrong("is no zip archive");
    const files = {};
    let at = bytes.readUInt32LE(end + 16);
    for (let n = bytes.readUInt16LE(end + 10); n > 0; --n) {
        if (at + 46 > bytes.length || bytes.readUInt32LE(at) !== 0x02014b50)
            throw wrong("its directory is damaged");
        const method = bytes.readUInt16LE(at + 10), size = bytes.readUInt32LE(at + 20);
        const length = bytes.readUInt16LE(at + 28), local = bytes.readUInt32LE(at + 42);
        const name = bytes.toString("utf8", at + 46, at + 46 + length);
        if (local + 30 > bytes.length) throw wrong(`${name}: lies beyond the end`);
        const begin = local + 30 + bytes.readUInt16LE(local + 26) + bytes.readUInt16LE(local + 28);
        if (begin + size > bytes.length) throw wrong(`${name}: lies beyond the end`);
        const data = bytes.subarray(begin, begin + size);
        if (method !== 0 && method !== 8) throw wrong(`${name}: compression ${method}, expected 0 or 8`);
        files[name] = method === 0 ? data : zlib.inflateRawSync(data, { maxOutputLength: 1 << 24 });
        at += 46 + length + bytes.readUInt16LE(at + 30) + bytes.readUInt16LE(at + 32);
    }
    return files;
}

/// Returns the numbers of a .npy file: float32 or float64, little-endian.
function numbers(bytes, who) {
    if (!bytes || bytes.length < 10 || bytes.toString("latin1", 0, 6) !== "\x93NUMPY")
        throw new Error(`${who}: is no .npy file`);
    const wide = bytes[6] > 1, length = wide ? bytes.readUInt32LE(8) : bytes.readUInt16LE(8);
    const begin = (wide ? 12 : 10) + length, header = bytes.toString("latin1", wide ? 12 : 10, begin);
    const size = { "<f4": 4, "<f8": 8 }[/'descr': '([^']*)'/.exec(header)?.[1]];
    if (!size) throw new Error(`${who}: got ${header.trim()}, expected float32 or float64`);
    const all = [];
    for (let at = begin; at + size <= bytes.length; at += size)
        all.push(size === 4 ? bytes.readFloatLE(at) : bytes.readDoubleLE(at));
    return all;
}

/// Returns yaw and pitch [degrees] of the left eye's gaze and of the right one's, in the head's frame.
function gazesOf(capture, frame) {
    const file = path.join(capture, "params", frame, "gaze.npz");
    const arrays = unzipped(fs.readFileSync(file), file);
    return ["gaze_left", "gaze_right"].map((name) => {
        const v = numbers(arrays[`${name}.npy`], `${file}: ${name}`);
        if (v.length !== 3 || !(Math.abs(Math.hypot(...v) - 1) < 1e-3))
            throw new Error(`${file}: ${name}: got ${JSON.stringify(v)}, expected a unit vector`);
        return [Math.atan2(v[0], v[2]), Math.asin(Math.max(-1, Math.min(1, v[1])))].map((x) => (180 / Math.PI) * x);
    });
}

module.exports = { gazesOf, numbers, unzipped };
