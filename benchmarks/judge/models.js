// SPDX-License-Identifier: Apache-2.0
// models.js: models that are no part of rye, run in a headless Chromium on pictures. The page may load
// from this program alone: nothing is sent anywhere.
"use strict";

const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");

/// Run in the page: pictures as canvases of about 768 pixels, which detectors want.
const page = `(() => {
    const picture = async (url) => {
        const image = new Image();
        image.src = url;
        await image.decode();
        return image;
    };
    const canvas = (w, h) => {
        const c = document.createElement("canvas");
        c.width = w; c.height = h;
        return c;
    };
    const zoomed = (source, x, w, h, shift = 0) => {
        const zoom = Math.max(1, Math.round(768 / w)), c = canvas(w * zoom, h * zoom), g = c.getContext("2d");
        g.fillStyle = "white";
        g.fillRect(0, 0, c.width, c.height);
        g.drawImage(source, x, 0, w, h, shift * zoom, shift * zoom, c.width, c.height);
        return c;
    };
    // The first of photograph, render and render with the gaze at rest, which rye evaluate puts 2 pixels apart,
    // and of the photograph moved by 3 pixels to the right and down.
    window.parts = async (url, count) => {
        const image = await picture(url), w = (image.width - 4) / 3;
        if (w !== Math.floor(w)) throw new Error("no three pictures side by side");
        return [0, 1, 2, 0].slice(0, count).map((k, i) => zoomed(image, k * (w + 2), w, image.height, i === 3 ? 3 : 0));
    };
    // A picture of a capture before white.
    window.photograph = async (url, mask, over_black) => {
        const image = await picture(url), c = canvas(image.width, image.height);
        const g = c.getContext("2d", { willReadFrequently: true });
        g.drawImage(await picture(mask), 0, 0, c.width, c.height);
        const m = g.getImageData(0, 0, c.width, c.height).data.slice();
        g.drawImage(image, 0, 0);
        const d = g.getImageData(0, 0, c.width, c.height);
        for (let i = 0; i < d.data.length; ++i)
            if (i % 4 < 3) d.data[i] = (over_black ? d.data[i] : (d.data[i] * m[i]) / 255) + 255 - m[i];
        g.putImageData(d, 0, 0);
        return [zoomed(c, 0, c.width, c.height)];
    };
    // The face of a canvas; photographs are the same in many evaluations.
    const known = new Map();
    window.once = async (c) => {
        const pixels = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
        const key = [c.width, ...new Uint8Array(await crypto.subtle.digest("SHA-256", pixels))].join();
        if (!known.has(key)) known.set(key, await face(c));
        return known.get(key);
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

/// MediaPipe's landmarks, coefficients and pose; measures.js states what a face is.
const landmarker = {
    package: "@mediapipe/tasks-vision",
    file: "vision_bundle.js",
    start: `(async () => {
        await script("/@mediapipe/tasks-vision/vision_bundle.js");
        const files = await Vision.FilesetResolver.forVisionTasks("/@mediapipe/tasks-vision/wasm");
        const model = await Vision.FaceLandmarker.createFromOptions(files, {
            baseOptions: { modelAssetPath: "/face_landmarker.task", delegate: "CPU" },
            runningMode: "IMAGE", numFaces: 1, minFaceDetectionConfidence: 0.3, minFacePresenceConfidence: 0.3,
            outputFaceBlendshapes: true, outputFacialTransformationMatrixes: true });
        window.face = async (c) => {
            const r = model.detect(c);
            if (!r.faceLandmarks.length || r.faceLandmarks[0].length !== 478) return null;
            const scores = r.faceBlendshapes[0].categories.map((s) => [s.categoryName, s.score]);
            return { landmarks: r.faceLandmarks[0].map((p) => [p.x * c.width, p.y * c.height]),
                     coefficients: Object.fromEntries(scores.filter(([name]) => name !== "_neutral")),
                     matrix: Array.from(r.facialTransformationMatrixes[0].data) };
        };
        return true;
    })()`,
};

/// face-api's descriptor of identity, 128 numbers.
const identity = {
    package: "@vladmandic/face-api",
    file: "dist/face-api.js",
    start: `(async () => {
        await script("/@vladmandic/face-api/dist/face-api.js");
        await faceapi.tf.setBackend("cpu");
        await faceapi.tf.ready();
        const at = "/@vladmandic/face-api/model";
        await faceapi.nets.tinyFaceDetector.loadFromUri(at);
        await faceapi.nets.faceLandmark68Net.loadFromUri(at);
        await faceapi.nets.faceRecognitionNet.loadFromUri(at);
        const how = new faceapi.TinyFaceDetectorOptions({ inputSize: 224, scoreThreshold: 0.2 });
        window.face = async (c) => {
            const found = await faceapi.detectSingleFace(c, how).withFaceLandmarks().withFaceDescriptor();
            return found ? Array.from(found.descriptor) : null;
        };
        return true;
    })()`,
};

/// Starts a model. Returns faces(expression), which returns the faces of the canvases that an expression
/// of the page returns, looking at each picture once, and end(). Throws an Error that says what is
/// missing, or what the page says.
async function started(model, { chromium, modules, task }) {
    if (!fs.existsSync(path.join(modules, model.package, model.file)))
        throw new Error(`no ${model.package} in ${modules}`);
    if (model === landmarker && !task) throw new Error("no FACE_LANDMARKER, the path of face_landmarker.task");
    if (model === landmarker && !fs.existsSync(task)) throw new Error(`no file ${task}`);
    const own = fs.mkdtempSync(path.join(os.tmpdir(), "rye-models-"));
    let server = null, browser = null;
    const end = async () => {
        if (browser) await browser.end();
        if (server) server.close();
        fs.rmSync(own, { recursive: true, force: true });
    };
    try {
        const policy = "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'";
        fs.writeFileSync(path.join(own, "empty.html"), `<!doctype html><title>models</title>
            <link rel="icon" href="data:,"><meta http-equiv="Content-Security-Policy" content="${policy}">`);
        if (model === landmarker) fs.copyFileSync(task, path.join(own, "face_landmarker.task"));
        server = await serve([own, path.resolve(modules)]);
        browser = await Browser.start(chromium, [800, 600]);
        await browser.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/empty.html` });
        await browser.until("document.title === 'models'", 20000);
        await browser.evaluate(page);
        await browser.evaluate(model.start);
    } catch (e) {
        await end();
        throw e;
    }
    return { end, faces: (canvases) => browser.evaluate(`(async () => {
        const all = [];
        for (const c of await ${canvases}) all.push(await once(c));
        return all;
    })()`) };
}

/// Returns a file as an address that a page can load.
function dataUrl(file) {
    const kind = file.endsWith(".png") ? "png" : "jpeg";
    return `data:image/${kind};base64,${fs.readFileSync(file).toString("base64")}`;
}

/// Returns the paths that the two scripts share, from the environment.
function settings() {
    return { chromium: process.env.CHROMIUM, modules: process.env.MODULES, task: process.env.FACE_LANDMARKER };
}

module.exports = { dataUrl, identity, landmarker, settings, started };
