// SPDX-License-Identifier: Apache-2.0
// peers.js CHROMIUM WORK [SIZE...]: times of a picture of the same head, by the same camera that turns, in the
// same Chromium: of the gaze page in WORK/page by WebAssembly and WebGPU, and of WORK/head.ply by Spark and
// PlayCanvas, which npm put into WORK. A time is from the camera to the bytes of the picture; viewers sort
// beside it, unwaited for. Started by peers.sh. From the environment: ROUNDS (3), in turns; WASM=0 and
// WEBGPU=0 leave that out; FLAGS, Chromium's for a graphics card (docs/results/page.md has some); without
// them WebGL and WebGPU are SwiftShader, which is a processor's.
"use strict";

const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { Browser, serve } = require("../../../examples/video_tracker/browser.js");

const [chromium, work, ...sizes] = process.argv.slice(2);
const { ROUNDS = "3", WASM = "1", WEBGPU = "1", FLAGS = "" } = process.env;
const isolating = { "Cross-Origin-Opener-Policy": "same-origin", "Cross-Origin-Embedder-Policy": "require-corp" };
const software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--enable-unsafe-webgpu",
                  "--use-webgpu-adapter=swiftshader", "--enable-features=Vulkan"];
const flags = FLAGS ? FLAGS.split(" ") : software;

/// Pages that set window.picture(motion), which draws by rows of camera_from_world and reads the bytes.
const pages = {
    spark: `<script type="importmap">{"imports": {"three": "/node_modules/three/build/three.module.js",
        "three/addons/": "/node_modules/three/examples/jsm/",
        "spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script><script type="module">
        import * as THREE from "three";
        import { SplatMesh, SparkRenderer } from "spark";
        const { width, lens: [fx, fy] } = view, camera = new THREE.PerspectiveCamera(
            2 * Math.atan(width / 2 / fy) * 180 / Math.PI, fy / fx, 0.1, 500);
        const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
        const scene = new THREE.Scene(), splats = new SplatMesh({ url: "/head.ply" });
        renderer.setSize(size, size);
        document.body.append(renderer.domElement);
        scene.add(new SparkRenderer({ renderer }), splats);
        await splats.initialized;
        const gl = renderer.getContext(), bytes = new Uint8Array(4 * size * size);
        window.picture = (m) => {
            // y up and z back, where the page's are down and forward
            camera.matrixAutoUpdate = false;
            camera.matrix.set(...m).premultiply(new THREE.Matrix4().makeScale(1, -1, -1)).invert();
            camera.matrix.decompose(camera.position, camera.quaternion, camera.scale);
            camera.updateMatrixWorld(true);
            renderer.render(scene, camera);
            gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
            return bytes;
        };</script>`,
    playcanvas: `<canvas></canvas><script type="module">
        import * as pc from "/node_modules/playcanvas/build/playcanvas.mjs";
        const canvas = document.querySelector("canvas");
        canvas.width = canvas.height = size;
        const app = new pc.Application(canvas, { graphicsDeviceOptions: {
            antialias: false, preserveDrawingBuffer: true, alpha: false } });
        app.setCanvasResolution(pc.RESOLUTION_FIXED, size, size);
        const asset = new pc.Asset("head", "gsplat", { url: "/head.ply" });
        app.assets.add(asset);
        await new Promise((done, no) => { asset.ready(done); asset.on("error", no); app.assets.load(asset); });
        const head = new pc.Entity(), camera = new pc.Entity();
        head.addComponent("gsplat", { asset });
        camera.addComponent("camera", { fov: 2 * Math.atan(view.width / 2 / view.lens[1]) * 180 / Math.PI,
                                        clearColor: new pc.Color(0, 0, 0), nearClip: 0.1, farClip: 500 });
        app.root.addChild(head);
        app.root.addChild(camera);
        app.autoRender = false;
        app.start();
        const gl = app.graphicsDevice.gl, bytes = new Uint8Array(4 * size * size);
        window.picture = (m) => {
            const flip = [1, -1, -1, 1];
            const columns = Array.from({ length: 16 }, (_, i) => flip[i % 4] * m[4 * (i % 4) + (i >> 2)]);
            const world = new pc.Mat4().set(columns).invert();
            camera.setPosition(world.getTranslation());
            camera.setRotation(new pc.Quat().setFromMat4(world));
            app.update(1 / 60);
            app.render();
            gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
            return bytes;
        };</script>`,
};

/// The share of pixels that are not the colour of the corner.
const filled = (bytes) => `(() => { const d = ${bytes}; let n = 0;
    for (let i = 0; i < d.length; i += 4)
        if (Math.abs(d[i] - d[0]) + Math.abs(d[i + 1] - d[1]) + Math.abs(d[i + 2] - d[2]) > 24) ++n;
    return n / (d.length / 4); })()`;

async function main() {
    if (!work) throw new Error("peers.js: expected CHROMIUM WORK [SIZE...]");
    const versions = ["@sparkjsdev/spark", "three", "playcanvas"].map((name) =>
        `${name} ${JSON.parse(fs.readFileSync(path.join(work, "node_modules", name, "package.json"))).version}`);
    const shown = path.join(work, "shown");
    fs.mkdirSync(shown, { recursive: true });
    const own = await serve([path.join(work, "page")], isolating), others = await serve([shown, work]);
    const b = await Browser.start(chromium, [1100, 1100], flags);
    const address = (server, rest) => `http://127.0.0.1:${server.address().port}/${rest}`;
    const times = {};
    let share = {};
    const ours = async (size, threads, by) => {
        await b.call("Page.navigate", { url: address(own, `?draw=${by}&threads=${threads}`) });
        await b.until("window.gazePage && gazePage.firstPicture !== null", 120000);
        await b.evaluate("document.getElementById('alive').checked = false; true");
        if (await b.evaluate("gazePage.last.by") !== by) throw new Error(`not drawn by ${by}`);
        const count = by === "webgpu" && flags === software ? 1 : 7;
        const got = await b.evaluate(`(async () => { const times = [];
            await gazePage.show({ gaze: [0, 0, 0, 0], pose: avatar.pose, expression: avatar.expression }, ${size});
            for (let i = 0; i < ${count}; ++i) { orbit.turn(0.01, 0);
                times.push((await gazePage.show({ motion: orbit.motion() }, ${size})).ms); }
            return times; })()`);
        const p = "(() => { const c = document.getElementById('picture'); return c.getContext('2d').getImageData(0, 0, c.width, c.height).data; })()";
        return [got, await b.evaluate(filled(p))];
    };
    const theirs = async (name, size, view) => {
        fs.writeFileSync(path.join(shown, `${name}.html`), "<!doctype html><meta charset=utf-8><link rel=icon href=data:,>" +
            `<style>body { margin: 0 }</style><body><script>const size = ${size}, view = ${JSON.stringify(view)};</script>${pages[name]}`);
        await b.call("Page.navigate", { url: address(others, `${name}.html`) });
        await b.until("window.picture !== undefined", 60000);
        // Until the first sort has come.
        for (let i = 0; i < 4; ++i)
            await b.evaluate(`(async () => { picture(view.motions[0]); await new Promise((done) => setTimeout(done, 300)); })()`);
        const got = await b.evaluate(`(async () => { const times = [];
            for (const m of view.motions) {
                const begun = performance.now();
                picture(m);
                times.push(performance.now() - begun);
                await new Promise((done) => setTimeout(done, 150));
            }
            return times; })()`);
        const seen = await b.evaluate(filled("picture(view.motions.at(-1))"));
        await b.screenshot(path.join(shown, `${name}_${size}.png`));
        return [got, seen];
    };
    try {
        console.log(`${(await b.call("Browser.getVersion")).product}; ${versions.join(", ")}; ${os.cpus()[0].model}, ` +
                    `${os.cpus().length} processors`);
        await b.call("Page.navigate", { url: address(own, "?draw=wasm") });
        await b.until("window.gazePage && gazePage.firstPicture !== null", 60000);
        const view = await b.evaluate(`({ width: avatar.width, lens: avatar.lens, gaussians: avatar.gaussians,
            motions: Array.from({ length: 7 }, () => (orbit.turn(0.01, 0), orbit.motion())) })`);
        console.log(`${view.gaussians} Gaussians; the camera turns; least and median, of ${ROUNDS} rounds [ms]`);
        for (const size of (sizes.length > 0 ? sizes : ["256", "512", "1024"]).map(Number)) {
            const kinds = {
                ...(WASM === "0" ? {} : {
                    "rye, WebAssembly, 1 thread": () => ours(size, 1, "wasm"),
                    "rye, WebAssembly, 2 threads": () => ours(size, 2, "wasm"),
                }),
                "Spark, WebGL": () => theirs("spark", size, view),
                "PlayCanvas, WebGL": () => theirs("playcanvas", size, view),
                ...(WEBGPU === "0" ? {} : { "rye, WebGPU": () => ours(size, 2, "webgpu") }),
            };
            const loads = [];
            for (let round = 0; round < Number(ROUNDS); ++round)
                for (const [what, measure] of Object.entries(kinds)) {
                    loads.push(os.loadavg()[0]);
                    const [got, seen] = await measure();
                    (times[`${size} ${what}`] ??= []).push(...got);
                    share[what] = seen;
                }
            for (const what of Object.keys(kinds)) {
                const t = times[`${size} ${what}`].sort((x, y) => x - y);
                console.log(`${`${size} x ${size}`.padEnd(12)} ${what.padEnd(28)} ${t[0].toFixed(1).padStart(9)} ` +
                            `${t[t.length >> 1].toFixed(1).padStart(9)}   ${(100 * share[what]).toFixed(0)} % of the pixels filled`);
            }
            console.log(`a load of ${Math.min(...loads).toFixed(1)} to ${Math.max(...loads).toFixed(1)}`);
        }
        for (const fault of b.faults.slice(0, 5)) console.log(`  console: ${fault.slice(0, 200)}`);
    } finally {
        await b.end();
        own.close();
        others.close();
    }
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
