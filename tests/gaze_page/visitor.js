// SPDX-License-Identifier: Apache-2.0
// visitor.js CHROMIUM PAGE CAPTURE OUT: the camera of the gaze page in PAGE, which was built with MEDIAPIPE.
// A false camera plays a picture of CAPTURE, a capture of `rye capture`, at several sides: the page's
// head has to look there. Then what is missing: a camera, leave, MediaPipe. Needs ffmpeg. Prints each
// figure with its bound, writes screenshots to OUT, and fails if a bound does not hold.
"use strict";

const { execFileSync } = require("node:child_process");
const fs = require("node:fs");
const path = require("node:path");
const { Browser, serve } = require("../../examples/video_tracker/browser.js");
const { Figures } = require("./measures.js");
const { halfField } = require("../../examples/gaze_page/face.js");

const [chromium, page, capture, out] = process.argv.slice(2);
const figures = new Figures();
const figure = figures.add.bind(figures);
const [width, height, side] = [640, 480, 230];  // of the camera's picture, of the head in it [px]
const degrees = (x) => (x * 180) / Math.PI;

/// A video of the head with its upper left corner at a place [px].
function video(name, [x, y]) {
    const file = path.join(out, `${name}.y4m`);
    execFileSync("ffmpeg", ["-v", "error", "-y", "-f", "lavfi", "-i", `color=gray:s=${width}x${height}:d=2:r=10`,
        "-i", path.join(capture, "images/0000/image_01.jpg"), "-filter_complex",
        `[1]scale=${side}:${side}[head];[0][head]overlay=${x}:${y}`, "-pix_fmt", "yuv420p", file], { stdio: "inherit" });
    return file;
}

/// Run in the page: the middle of both eyes in the capture's picture, of its sides.
const eyes = `(async () => {
    const image = new Image();
    image.src = "images/0000/eye_mask_01.png";
    await image.decode();
    const c = new OffscreenCanvas(image.width, image.height), g = c.getContext("2d");
    g.drawImage(image, 0, 0);
    const { data } = g.getImageData(0, 0, c.width, c.height);
    // Of each eye by itself: they are grey levels of the mask.
    const sums = {};
    for (let i = 0; i < data.length; i += 4) {
        if (data[i] === 0) continue;
        const s = sums[data[i]] ??= [0, 0, 0];
        s[0] += 1; s[1] += (i / 4) % c.width + 0.5; s[2] += Math.floor(i / 4 / c.width) + 0.5;
    }
    const large = Object.values(sums).sort((a, b) => b[0] - a[0]).slice(0, 2);
    return [1, 2].map((k) => (large[0][k] / large[0][0] + large[1][k] / large[1][0]) / 2 / c.width);
})()`;

/// Run in the page: where both eyes look as the page shows it: right and up [rad], the mean.
const looks = `(() => {
    const r = rotation(pose().slice(0, 3)), axes = orbit.axes(), sum = [0, 0];
    for (const e of [0, 1]) {
        const [pitch, yaw] = goal.slice(2 * e, 2 * e + 2);
        const d = times(axes, times(r, [Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch)]));
        sum[0] += Math.atan2(d[0], d[2]) / 2;
        sum[1] += Math.asin(d[1]) / 2;
    }
    return sum;
})()`;

const camera = (file) => ["--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream",
                          ...(file ? [`--use-file-for-fake-video-capture=${file}`] : [])];

async function visit(b, url) {
    await b.call("Page.navigate", { url });
    await b.until("window.gazePage && gazePage.firstPicture !== null", 60000);
    await b.evaluate("document.getElementById('controls').open = true");
}
const said = "document.getElementById('visitor').textContent";

async function main() {
    if (!out) throw new Error("visitor.js: expected CHROMIUM PAGE CAPTURE OUT");
    fs.mkdirSync(out, { recursive: true });
    const server = await serve([page, capture]);
    const url = `http://127.0.0.1:${server.address().port}/?draw=wasm`;
    // Within the gazes that the capture's few frames have.
    const places = { right: [285, 120], left: [125, 120], above: [205, 40] };
    for (const [name, place] of Object.entries(places)) {
        const b = await Browser.start(chromium, [1280, 860], camera(video(name, place)));
        try {
            await visit(b, url);
            const [u, v] = await b.evaluate(eyes);
            const focal = height / 2 / Math.tan(halfField);
            // The camera's right is the page's left.
            const across = (place[0] + side * u - width / 2) / focal, up = (height / 2 - place[1] - side * v) / focal;
            const wanted = [-Math.atan(across), Math.atan2(up, Math.hypot(1, across))];
            await b.evaluate("document.getElementById('look').click()");
            await b.until(`${said}.startsWith('Nothing leaves')`, 60000);
            await b.until(`gaze.every((g, i) => Math.abs(g - goal[i]) < 0.02) && goal[1] !== 0`, 30000);
            const got = await b.evaluate(looks);
            const off = degrees(Math.hypot(got[0] - wanted[0], got[1] - wanted[1]));
            figure(`a visitor at the camera's ${name}: the head looks`,
                   got.map((x) => degrees(x).toFixed(1)).join(", "), off <= 4,
                   `within 4 degrees of ${wanted.map((x) => degrees(x).toFixed(1)).join(", ")}`);
            await b.screenshot(path.join(out, `visitor_${name}.png`));
            if (name === "right") {
                const before = await b.evaluate("[...expression]");
                await b.evaluate("document.getElementById('drive').click()");
                await b.until(`expression.some((x, i) => x !== ${JSON.stringify(before)}[i])`, 30000);
                await b.until("gaze.every((g, i) => Math.abs(g - goal[i]) < 0.02)", 30000);
                const driven = await b.evaluate(`[document.getElementById("look").getAttribute("aria-pressed"),
                    expression.every((x, i) => x >= avatar.low[i] && x <= avatar.high[i]), Math.max(...gaze.map(Math.abs))]`);
                figure("driven by the face: within the ranges, gaze [rad]", `${driven[1]}, ${driven[2].toFixed(2)}`,
                       driven[0] === "false" && driven[1] && driven[2] < 0.35, "true, below 0.35");
                await b.evaluate("document.getElementById('drive').click()");
                await b.until(`${said} === "" && document.getElementById("drive").getAttribute("aria-pressed") === "false"`, 5000);
            }
            const beyond = await b.evaluate(`performance.getEntriesByType("resource").map((e) => e.name)
                .filter((name) => !name.startsWith(location.origin) && !/^(data|blob):/.test(name))`);
            figure("addresses beyond the page's host", beyond.join(" ") || "none", beyond.length === 0, "none");
            const faults = b.faults.filter((text) => !/^([WI]\d{4} |INFO: )/.test(text));  // MediaPipe's words
            figure("errors of the page and of the console", String(faults.length), faults.length === 0, "0");
            for (const fault of faults) console.log(`  ${fault}`);
        } finally {
            await b.end();
        }
    }

    const without = path.join(out, "without");
    fs.rmSync(without, { recursive: true, force: true });
    fs.mkdirSync(without);
    for (const name of fs.readdirSync(page))
        if (name !== "mediapipe") fs.symlinkSync(path.resolve(page, name), path.join(without, name));
    const bare = await serve([without]);
    const cases = [
        ["no camera", url, [], /^(There is no camera|The camera was not allowed)\. The page goes on/],
        ["leave refused", url, ["--use-fake-device-for-media-stream", "--deny-permission-prompts"],
         /^The camera was not allowed\. The page goes on/],
        ["no MediaPipe", `http://127.0.0.1:${bare.address().port}/?draw=wasm`, camera(), /^This page was built without MediaPipe/],
    ];
    for (const [what, address, flags, words] of cases) {
        const b = await Browser.start(chromium, [1280, 860], flags);
        try {
            await visit(b, address);
            await b.evaluate("document.getElementById('look').click()");
            await b.until(`${said}.endsWith("without.")`, 60000);
            const text = await b.evaluate(said);
            const { frames } = await b.evaluate("gazePage.show({ gaze: [0, 0.1, 0, 0.1] }).then(() => gazePage)");
            figure(`${what}: a sentence, and the page goes on`, String(words.test(text)), words.test(text) && frames > 1, "true");
            console.log(`  ${text}`);
        } finally {
            await b.end();
        }
    }
    server.close();
    bare.close();
    figures.end();
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
