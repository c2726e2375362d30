// SPDX-License-Identifier: Apache-2.0
// photographs.js CAPTURE: what the judge itself knows of gaze: its gazes on the photographs of a
// capture's test frames against the labels, by irises and by the eyeLook coefficients; the calibrations
// by training frames (measures.js has that of capture A's irises); and how far apart it sees two gazes of
// an eye in the photographs of one camera. The capture is one of `rye capture` or of that form, with
// capture.json. judge.sh sets the environment.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { gazesOf } = require("./labels.js");
const m = require("./measures.js");
const { dataUrl, landmarker, settings, started } = require("./models.js");

const kinds = { irises: m.irisOffset, coefficients: m.lookOffset };

function picture(folder, name) {
    return ["png", "jpg"].map((kind) => path.join(folder, `${name}.${kind}`)).find((f) => fs.existsSync(f));
}

/// Returns the photographs of frames: camera angles and open eyes, each with label and offsets; null
/// where no face was found.
async function photographs(faces, capture, description, frames) {
    const black = String(description.conventions?.image ?? "").includes("over black"), all = [];
    for (const frame of frames) {
        const labels = gazesOf(capture, frame), folder = path.join(capture, "images", frame);
        for (const camera of description.camera_ids) {
            const [image, mask] = ["image", "mask"].map((n) => picture(folder, `${n}_${camera}`));
            if (!image || !mask) continue;
            const [face] = await faces(`photograph("${dataUrl(image)}", "${dataUrl(mask)}", ${black})`);
            const angles = face && m.cameraAngles(face);
            all.push(face && {
                camera,
                offAxis: m.offAxis(angles),
                eyes: m.eyes.map((eye, e) => ({
                    eye, gaze: labels[e], camera: angles, blink: face.coefficients[`eyeBlink${eye.name}`],
                    irises: m.irisOffset(face, eye), coefficients: m.lookOffset(face, eye),
                })).filter((e) => e.blink < m.open),
            });
        }
    }
    return all;
}

const eyesWithin = (views, from, to) =>
    views.filter((v) => v && v.offAxis >= from && v.offAxis < to).flatMap((v) => v.eyes);
const offsetOf = (e, kind) => ({ eye: e.eye, gaze: e.gaze, camera: e.camera, offset: e[kind] });
/// Returns [true, seen] angles between gazes of an eye, for each two photographs of one camera.
function pairs(views) {
    const all = [];
    views.forEach((a, i) => views.slice(i + 1).filter((b) => b.camera === a.camera).forEach((b) => {
        for (const p of a.eyes) {
            const q = b.eyes.find((e) => e.eye === p.eye);
            const of = (e) => m.gazeOf(e.irises, e.eye, e.camera, m.irisCalibration);
            if (q) all.push([m.angle(p.gaze, q.gaze), m.angle(of(p), of(q))]);
        }
    }));
    return all;
}
const errorsOf = (eyes, kind, calibration) =>
    eyes.map((e) => m.angle(m.gazeOf(e[kind], e.eye, e.camera, calibration), e.gaze));
const shown = (x) => (x === null ? "-" : `${x.toFixed(1)}°`);
const listed = (calibration) => JSON.stringify(calibration.map((row) => row.map((x) => Number(x.toFixed(5)))));

async function main() {
    const [capture] = process.argv.slice(2);
    const description = JSON.parse(fs.readFileSync(path.join(capture, "capture.json"), "utf8"));
    for (const field of ["train_frames", "test_frames", "camera_ids"])
        if (!Array.isArray(description[field]))
            throw new Error(`${capture}/capture.json: field '${field}' is missing`);
    const model = await started(landmarker, settings());
    let train, test;
    try {
        train = await photographs(model.faces, capture, description, description.train_frames);
        test = await photographs(model.faces, capture, description, description.test_frames);
    } finally {
        await model.end();
    }
    const own = Object.fromEntries(Object.keys(kinds).map((kind) =>
        [kind, m.calibrated(eyesWithin(train, 0, m.cone).map((e) => offsetOf(e, kind)))]));
    const found = [...train, ...test].filter((v) => v).length;
    console.log(`${capture}: faces on ${found} of ${train.length + test.length} photographs. Test frames, open eyes `
        + `(eyeBlink below ${m.open}):\n`);
    console.log("| camera beside the face's axis | eyes | by irises | by irises, calibrated here "
        + "| by eyeLook coefficients, calibrated here | straight ahead |\n|---|---|---|---|---|---|");
    for (const [from, to] of [[0, m.cone], [m.cone, 30], [30, 45], [45, 180]]) {
        const eyes = eyesWithin(test, from, to);
        const cells = [
            errorsOf(eyes, "irises", m.irisCalibration), errorsOf(eyes, "irises", own.irises),
            errorsOf(eyes, "coefficients", own.coefficients), eyes.map((e) => m.angle([0, 0], e.gaze))];
        console.log(`| ${from}° to ${to}° | ${eyes.length} | ${cells.map((c) => shown(m.mean(c))).join(" | ")} |`);
    }
    console.log(`\nMean angles to the label. Calibrated by training frames, cameras below ${m.cone}°:`);
    for (const kind of Object.keys(kinds)) console.log(`${kind}: ${listed(own[kind])}`);
    const both = pairs([...train, ...test].filter((v) => v && v.offAxis < m.cone));
    console.log("\nTwo photographs of one camera, all frames:\n\n| gazes of an eye apart by | pairs | mean | by irises "
        + "|\n|---|---|---|---|");
    for (const [from, to] of [[0, 5], [5, 10], [10, 15], [15, 20], [20, 30]]) {
        const within = both.filter(([apart]) => apart >= from && apart < to);
        const means = [0, 1].map((k) => shown(m.mean(within.map((p) => p[k]))));
        console.log(`| ${from}° to ${to}° | ${within.length} | ${means.join(" | ")} |`);
    }
}

main().catch((e) => {
    console.log(`not run: gaze of the judge on photographs: ${String(e.message).split("\n")[0]}`);
    process.exitCode = /^no /.test(e.message) ? 0 : 1;
});
