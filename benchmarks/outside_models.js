// SPDX-License-Identifier: Apache-2.0
// outside_models.js CHROMIUM MODULES FOLDER...: the photographs and renders that `rye evaluate` wrote to
// FOLDER (evaluate_SPLIT), judged by models that are no part of rye, in a headless Chromium:
//   @vladmandic/face-api   68 landmarks, and a descriptor of identity of 128 numbers
//   @mediapipe/face_mesh   478 landmarks with both irises
// MODULES is a node_modules folder that has one of them or both. Prints a table; a package that is not
// there, or does not run, is named in a line that begins with "not run: ". The photograph decides what
// counts: a face that a model finds on it but not on the render counts the error that is named
// `missed` below.
"use strict";

const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { Browser, serve } = require("../examples/video_tracker/browser.js");

const missed = { landmarks: 100, identity: 1, irises: 50 };
const packages = { "@vladmandic/face-api": "dist/face-api.js", "@mediapipe/face_mesh": "face_mesh.js" };

/// Run in the page: the three pictures that `rye evaluate` puts side by side, 2 pixels apart; the
/// first two, four times as large, which detectors want.
const page = `(() => {
    window.parts = async (url) => {
        const image = new Image();
        image.src = url;
        await image.decode();
        const w = (image.width - 4) / 3, h = image.height;
        if (w !== Math.floor(w)) throw new Error("no three pictures side by side");
        const zoom = Math.max(1, Math.round(768 / w));
        return [0, 1].map((k) => {
            const c = document.createElement("canvas");
            c.width = w * zoom; c.height = h * zoom;
            c.getContext("2d").drawImage(image, k * (w + 2), 0, w, h, 0, 0, c.width, c.height);
            return c;
        });
    };
    window.script = (url) => new Promise((resolve, reject) => {
        const s = document.createElement("script");
        s.src = url;
        s.onload = resolve;
        s.onerror = () => reject(new Error(url + " cannot be loaded"));
        document.head.append(s);
    });
    return true;
})()`;

/// Run in the page: face-api's landmarks, as a share of the distance between the eyes, and identity.
const faceApi = {
    start: `(async () => {
        await script("/@vladmandic/face-api/dist/face-api.js");
        await faceapi.tf.setBackend("cpu");
        await faceapi.tf.ready();
        const at = "/@vladmandic/face-api/model";
        await faceapi.nets.tinyFaceDetector.loadFromUri(at);
        await faceapi.nets.faceLandmark68Net.loadFromUri(at);
        await faceapi.nets.faceRecognitionNet.loadFromUri(at);
        const how = new faceapi.TinyFaceDetectorOptions({ inputSize: 224, scoreThreshold: 0.2 });
        window.judge = async (url) => {
            const [photograph, render] = await parts(url);
            const face = (c) => faceapi.detectSingleFace(c, how).withFaceLandmarks().withFaceDescriptor();
            const a = await face(photograph);
            if (!a) return null;
            const b = await face(render);
            if (!b) return { landmarks: null, identity: null };
            const p = a.landmarks.positions, q = b.landmarks.positions;
            const middle = (x, from) => [0, 1].map((k) => {
                let sum = 0;
                for (let i = from; i < from + 6; ++i) sum += k ? x[i].y : x[i].x;
                return sum / 6;
            });
            const l = middle(p, 36), r = middle(p, 42), apart = Math.hypot(l[0] - r[0], l[1] - r[1]);
            let sum = 0;
            for (let i = 0; i < 68; ++i) sum += Math.hypot(p[i].x - q[i].x, p[i].y - q[i].y);
            return { landmarks: (100 * sum) / 68 / apart,
                     identity: faceapi.euclideanDistance(a.descriptor, b.descriptor) };
        };
        return true;
    })()`,
    measures: ["landmarks", "identity"],
};

/// Run in the page: how far the irises are from where they are on the photograph, in their eyes, as a
/// share of the eyes' widths.
const faceMesh = {
    start: `(async () => {
        await script("/@mediapipe/face_mesh/face_mesh.js");
        const mesh = new FaceMesh({ locateFile: (f) => "/@mediapipe/face_mesh/" + f });
        mesh.setOptions({ staticImageMode: true, maxNumFaces: 1, refineLandmarks: true,
                          minDetectionConfidence: 0.3 });
        let found = null;
        mesh.onResults((r) => { found = r.multiFaceLandmarks?.[0] ?? null; });
        await mesh.initialize();
        // [first corner, second corner, iris] of an eye.
        const eyes = [[33, 133, 468], [362, 263, 473]];
        const offsets = async (c) => {
            found = null;
            mesh.reset();
            await mesh.send({ image: c });
            if (!found || found.length < 478) return null;
            return eyes.map((e) => {
                const [a, b, i] = e.map((k) => [found[k].x * c.width, found[k].y * c.height]);
                const u = [b[0] - a[0], b[1] - a[1]], n = u[0] * u[0] + u[1] * u[1];
                const d = [i[0] - (a[0] + b[0]) / 2, i[1] - (a[1] + b[1]) / 2];
                return [(d[0] * u[0] + d[1] * u[1]) / n, (d[1] * u[0] - d[0] * u[1]) / n];
            });
        };
        window.judge = async (url) => {
            const [photograph, render] = await parts(url);
            const a = await offsets(photograph);
            if (!a) return null;
            const b = await offsets(render);
            if (!b) return { irises: null };
            return { irises: 50 * a.reduce((s, o, e) => s + Math.hypot(o[0] - b[e][0], o[1] - b[e][1]), 0) };
        };
        return true;
    })()`,
    measures: ["irises"],
};

async function judged(chromium, modules, folders, model) {
    const own = fs.mkdtempSync(path.join(os.tmpdir(), "rye-models-"));
    fs.writeFileSync(path.join(own, "empty.html"), "<!doctype html><title>models</title>");
    const server = await serve([own, modules]);
    const b = await Browser.start(chromium, [800, 600]);
    try {
        await b.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/empty.html` });
        await b.until("document.title === 'models'", 20000);
        await b.evaluate(page);
        await b.evaluate(model.start);
        const all = {};
        for (const folder of folders) {
            const rows = [];
            for (const name of fs.readdirSync(folder).filter((f) => f.endsWith(".png")).sort()) {
                const bytes = fs.readFileSync(path.join(folder, name)).toString("base64");
                rows.push(await b.evaluate(`judge("data:image/png;base64,${bytes}")`));
            }
            all[folder] = rows;
        }
        return all;
    } finally {
        await b.end();
        server.close();
        fs.rmSync(own, { recursive: true, force: true });
    }
}

async function main() {
    const [chromium, modules, ...folders] = process.argv.slice(2);
    const table = new Map(folders.map((f) => [f, {}]));
    for (const [name, model] of [["@vladmandic/face-api", faceApi], ["@mediapipe/face_mesh", faceMesh]]) {
        if (!fs.existsSync(path.join(modules, name, packages[name]))) {
            console.log(`not run: ${model.measures.join(", ")}: no ${name} in ${modules}`);
            continue;
        }
        let results;
        try {
            results = await judged(chromium, path.resolve(modules), folders, model);
        } catch (e) {
            console.log(`not run: ${model.measures.join(", ")}: ${name}: ${String(e.message).split("\n")[0]}`);
            continue;
        }
        for (const [folder, rows] of Object.entries(results)) {
            const counted = rows.filter((r) => r !== null);
            for (const m of model.measures) {
                const sum = counted.reduce((s, r) => s + (r[m] === null ? missed[m] : r[m]), 0);
                table.get(folder)[m] = {
                    mean: counted.length ? sum / counted.length : NaN,
                    text: `${counted.filter((r) => r[m] !== null).length}, ${counted.length} of ${rows.length}`,
                };
            }
        }
    }
    const cell = (t, m, digits) => (t[m] ? t[m].mean.toFixed(digits) : "-");
    const found = (t, m) => (t[m] ? t[m].text : "-");
    console.log("\n| pictures | landmarks [% of the eyes' distance] | identity distance | faces: render, photograph "
        + "| irises [% of an eye's width] | faces: render, photograph |\n|---|---|---|---|---|---|");
    for (const [folder, t] of table)
        console.log(`| ${folder} | ${cell(t, "landmarks", 2)} | ${cell(t, "identity", 3)} | ${found(t, "identity")} `
            + `| ${cell(t, "irises", 2)} | ${found(t, "irises")} |`);
    console.log(`\nRender against photograph. A face that is found on the photograph alone counts ${missed.landmarks}, `
        + `${missed.identity} and ${missed.irises}. Equal pictures have 0 in each.`);
}

main().catch((e) => {
    console.error(`outside_models: ${e.message}`);
    process.exit(1);
});
