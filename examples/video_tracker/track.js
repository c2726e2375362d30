// SPDX-License-Identifier: Apache-2.0
// track.js CHROMIUM MODULES MODEL FOLDER: tracks the face in the pictures of FOLDER/frames.jsonl, in a
// headless Chromium, and appends a line for each to FOLDER/tracks.jsonl, which `rye import video`
// reads; pictures that have a line already are left out, so that what was interrupted is continued.
//   MODULES   node_modules with @mediapipe/tasks-vision and @mediapipe/selfie_segmentation
//   MODEL     face_landmarker.task
// A line of frames.jsonl: {"picture": "frames/000001.jpg", "time": 0.2}, seconds. One of tracks.jsonl:
//   picture, time   of frames.jsonl
//   size            width and height [px]
//   faces           number of faces found; what follows is of the first, and missing without one
//   landmarks       478 x [x, y, z], pixels from the picture's upper left corner, z away from the camera
//   coefficients    {"browDownLeft": 0.1, ...}, 0 to 1
//   matrix          4 x 4, column by column: the canonical face [cm] to a camera's frame
//   sharpness       standard deviation of the second differences in the face, at 160 pixels a side
//   mask            PNG of the person, of the picture's size
// Prints "tracked DONE of ALL" after each picture.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const { Browser, serve } = require("./browser.js");
const { pictureMetadata, withMetadata } = require("./metadata.js");

/// Run in the page.
const page = `(async () => {
    const { FaceLandmarker, FilesetResolver, ImageSegmenter } =
        await import("/@mediapipe/tasks-vision/vision_bundle.mjs");
    const files = await FilesetResolver.forVisionTasks("/@mediapipe/tasks-vision/wasm");
    const bytes = async (url) => new Uint8Array(await (await fetch(url)).arrayBuffer());
    const landmarker = await FaceLandmarker.createFromOptions(files, {
        baseOptions: { modelAssetBuffer: await bytes("/model"), delegate: "CPU" },
        runningMode: "IMAGE", numFaces: 2, outputFaceBlendshapes: true,
        outputFacialTransformationMatrixes: true });
    const segmenter = await ImageSegmenter.createFromOptions(files, {
        baseOptions: { modelAssetBuffer: await bytes("/segmenter"), delegate: "CPU" },
        runningMode: "IMAGE", outputConfidenceMasks: true, outputCategoryMask: false });
    const canvas = (w, h) => {
        const c = document.createElement("canvas");
        c.width = w; c.height = h;
        return c;
    };
    const context = (c) => c.getContext("2d", { willReadFrequently: true });
    // Of the face's box, at 160 pixels a side.
    const sharpness = (image, box) => {
        const side = 160, c = canvas(side, side), g = context(c);
        g.drawImage(image, box.x, box.y, box.side, box.side, 0, 0, side, side);
        const p = g.getImageData(0, 0, side, side).data, grey = (x, y) => {
            const i = 4 * (y * side + x);
            return 0.299 * p[i] + 0.587 * p[i + 1] + 0.114 * p[i + 2];
        };
        let sum = 0, squares = 0, n = 0;
        for (let y = 1; y + 1 < side; ++y)
            for (let x = 1; x + 1 < side; ++x, ++n) {
                const d = grey(x - 1, y) + grey(x + 1, y) + grey(x, y - 1) + grey(x, y + 1) - 4 * grey(x, y);
                sum += d; squares += d * d;
            }
        return Math.sqrt(Math.max(0, squares / n - (sum / n) ** 2));
    };
    // The person around the face, as a picture of the whole size; the model looks at a square.
    const person = (image, face) => {
        const side = 2.6 * face.side, x = face.x + face.side / 2 - side / 2,
              y = face.y + face.side / 2 - 0.54 * side;
        const square = canvas(512, 512);
        context(square).drawImage(image, x, y, side, side, 0, 0, 512, 512);
        const result = segmenter.segment(square), masks = result.confidenceMasks;
        const mask = masks[masks.length - 1], values = mask.getAsFloat32Array();
        const small = canvas(mask.width, mask.height), data = new ImageData(mask.width, mask.height);
        for (let i = 0; i < values.length; ++i) {
            data.data.fill(Math.round(255 * values[i]), 4 * i, 4 * i + 3);
            data.data[4 * i + 3] = 255;
        }
        result.close();
        context(small).putImageData(data, 0, 0);
        const whole = canvas(image.width, image.height), g = context(whole);
        g.fillRect(0, 0, image.width, image.height);
        g.drawImage(small, x, y, side, side);
        return whole.toDataURL("image/png").split(",")[1];
    };
    window.track = async (url) => {
        const image = new Image();
        image.src = url;
        await image.decode();
        const w = image.width, h = image.height, found = landmarker.detect(image);
        const line = { size: [w, h], faces: found.faceLandmarks.length };
        if (line.faces === 0) return { line };
        const points = found.faceLandmarks[0];
        const xs = points.map((p) => p.x * w), ys = points.map((p) => p.y * h);
        const low = [Math.min(...xs), Math.min(...ys)], high = [Math.max(...xs), Math.max(...ys)];
        const side = Math.max(high[0] - low[0], high[1] - low[1]);
        const box = { x: (low[0] + high[0] - side) / 2, y: (low[1] + high[1] - side) / 2, side };
        const rounded = (x, digits) => Number(x.toFixed(digits));
        line.landmarks = points.map((p) => [rounded(p.x * w, 3), rounded(p.y * h, 3), rounded(p.z * w, 3)]);
        line.coefficients = {};
        for (const c of found.faceBlendshapes[0].categories)
            line.coefficients[c.categoryName] = rounded(c.score, 5);
        line.matrix = found.facialTransformationMatrixes[0].data.map((x) => rounded(x, 6));
        line.sharpness = rounded(sharpness(image, box), 3);
        return { line, mask: person(image, box) };
    };
    return true;
})()`;

/// The lines of a file that are whole; what an interruption cut is no line.
function lines(file) {
    if (!fs.existsSync(file)) return [];
    const text = fs.readFileSync(file, "utf8");
    return text.slice(0, text.lastIndexOf("\n") + 1).split("\n").filter(Boolean).map((l) => JSON.parse(l));
}

async function main() {
    const [chromium, modules, model, folder] = process.argv.slice(2);
    if (!folder) throw new Error("expected CHROMIUM MODULES MODEL FOLDER");
    const out = path.join(folder, "tracks.jsonl"), before = lines(out);
    fs.writeFileSync(out, before.map((l) => `${JSON.stringify(l)}\n`).join(""));
    const done = new Set(before.map((l) => l.picture));
    const frames = lines(path.join(folder, "frames.jsonl"));
    const left = frames.filter((f) => !done.has(f.picture));
    fs.mkdirSync(path.join(folder, "masks"), { recursive: true });
    const own = fs.mkdtempSync(path.join(folder, "page-"));
    // The page may reach this server alone: the packages would report their use to their maker.
    const policy = "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval'";
    fs.writeFileSync(path.join(own, "empty.html"), `<!doctype html><title>tracker</title>
        <link rel="icon" href="data:,"><meta http-equiv="Content-Security-Policy" content="${policy}">`);
    fs.copyFileSync(model, path.join(own, "model"));
    const segmenter = path.join(modules, "@mediapipe/selfie_segmentation/selfie_segmentation.tflite");
    fs.writeFileSync(path.join(own, "segmenter"),
                     withMetadata(fs.readFileSync(segmenter), pictureMetadata(0, 255)));
    const server = await serve([own, folder, modules]);
    const browser = await Browser.start(chromium, [800, 600]);
    try {
        const at = `http://127.0.0.1:${server.address().port}`;
        await browser.call("Page.navigate", { url: `${at}/empty.html` });
        await browser.until("document.title === 'tracker'", 20000);
        if (left.length > 0) await browser.evaluate(page);
        for (let i = 0; i < left.length; ++i) {
            const { line, mask } = await browser.evaluate(`track("/${left[i].picture}")`);
            if (mask) {
                line.mask = `masks/${path.parse(left[i].picture).name}.png`;
                fs.writeFileSync(path.join(folder, line.mask), Buffer.from(mask, "base64"));
            }
            fs.appendFileSync(out, `${JSON.stringify({ ...left[i], ...line })}\n`);
            console.log(`tracked ${done.size + i + 1} of ${frames.length}`);
        }
    } finally {
        await browser.end();
        server.close();
        fs.rmSync(own, { recursive: true, force: true });
    }
}

main().catch((e) => {
    console.error(`track.js: ${String(e.message).split("\n")[0]}`);
    process.exit(1);
});
