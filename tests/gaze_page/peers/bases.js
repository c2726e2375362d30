// SPDX-License-Identifier: Apache-2.0
// bases.js CHROMIUM WORK RYE RUN: the linear bases of `rye export` on a SplatMesh of Spark, in a headless
// Chromium: PSNR of its pictures against Spark's of the splats exported at that very expression and gaze,
// and against those of `rye redirect`; sizes of the files; times of a picture that moves. Started by
// bases.sh, which puts the files of examples/spark and Spark itself into WORK. SIZE (512) from the
// environment; pictures stay in WORK/pictures.
"use strict";

const { execFileSync } = require("node:child_process");
const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const { Browser, serve } = require("../../../examples/video_tracker/browser.js");

const [chromium, work, rye, run] = process.argv.slice(2);
const size = Number(process.env.SIZE ?? 512);
const fov = 20, eye = [0, 0, 10];
const at = (name) => path.join(work, name);
const gazes = ["gaze_left_pitch", "gaze_left_yaw", "gaze_right_pitch", "gaze_right_yaw"];
const gaze = (pitch, yaw) => Object.fromEntries(gazes.map((name) => [name, name.endsWith("yaw") ? yaw : pitch]));

function rye_(...words) {
    return execFileSync(rye, words.map(String), { encoding: "utf8" });
}

/// What is compared: the coefficients that move the splats most, alone, in part and in pairs, and gazes.
function casesOf({ bases, begin, change }, { float, drivers }) {
    const moves = bases.map((b, k) => {
        let sum = 0;
        for (let e = begin[k]; e < begin[k + 1]; ++e)
            sum += Math.hypot(...[0, 1, 2].map((i) => float(change[13 * e + i])));
        return { ...b, sum };
    }).filter(({ driver }) => !gazes.includes(driver)).sort((a, b) => b.sum - a.sum);
    const most = moves.slice(0, 4), cases = [["at rest", {}]];
    for (const { driver, at } of most) cases.push([`${driver} = ${at.toFixed(2)}`, { [driver]: at }]);
    for (const { driver, at } of most.slice(0, 2))
        cases.push([`${driver} = ${(at / 2).toFixed(2)}`, { [driver]: at / 2 }]);
    for (const { driver } of most.slice(0, 2)) cases.push([`${driver} = 1`, { [driver]: 1 }]);
    for (const i of [0, 1]) {
        const [a, b] = [most[i], most[i + 2]];
        cases.push([`${a.driver} and ${b.driver}, as above`, { [a.driver]: a.at, [b.driver]: b.at }]);
    }
    for (const [pitch, yaw] of [[0, 10], [-10, 0], [0, 25], [15, 20]])
        cases.push([`gaze of pitch ${pitch}, yaw ${yaw}`, gaze(pitch, yaw)]);
    cases.push([`${most[0].driver} = ${most[0].at.toFixed(2)} and yaw 10`,
                { [most[0].driver]: most[0].at, ...gaze(0, 10) }]);
    for (const [, values] of cases)
        for (const name of Object.keys(values)) if (!drivers.has(name)) values[name] = undefined;
    return cases;
}

const page = `<!doctype html><meta charset=utf-8><link rel=icon href=data:,><style>body { margin: 0 }</style>
    <script type="importmap">{"imports": {"three": "/node_modules/three/build/three.module.js",
    "three/addons/": "/node_modules/three/examples/jsm/",
    "@sparkjsdev/spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script><script type="module">
    import * as THREE from "three";
    import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
    import { Bases } from "./spark.mjs";
    const size = ${size}, renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
    const scene = new THREE.Scene(), camera = new THREE.PerspectiveCamera(${fov}, 1, 0.1, 100);
    camera.position.set(...${JSON.stringify(eye)});
    renderer.setSize(size, size);
    renderer.setClearColor(0xffffff, 1);
    document.body.append(renderer.domElement);
    const spark = new SparkRenderer({ renderer });
    scene.add(spark);
    const gl = renderer.getContext(), kept = {};
    window.draw = () => {
        const bytes = new Uint8Array(4 * size * size);
        renderer.render(scene, camera);
        gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
        return bytes;
    };
    // The rows of WebGL begin at the bottom. Drawn again once what runs beside a picture has sorted.
    window.keep = async (name) => {
        draw();
        do await new Promise((done) => setTimeout(done, 200));
        while (spark.sorting || spark.sortDirty);
        const last = draw();
        const rows = new Uint8Array(last.length);
        for (let y = 0; y < size; ++y) rows.set(last.subarray(4 * size * y, 4 * size * (y + 1)), 4 * size * (size - 1 - y));
        kept[name] = rows;
    };
    window.keepFile = async (name, url) => {
        const image = await createImageBitmap(await (await fetch(url)).blob());
        const context = new OffscreenCanvas(size, size).getContext("2d");
        context.drawImage(image, 0, 0);
        kept[name] = new Uint8Array(context.getImageData(0, 0, size, size).data);
    };
    window.psnr = (a, b) => {
        let sum = 0;
        for (let i = 0; i < kept[a].length; ++i) if (i % 4 !== 3) sum += (kept[a][i] - kept[b][i]) ** 2;
        return sum === 0 ? 99 : 10 * Math.log10(255 * 255 * 3 * size * size / sum);
    };
    const open = async (url) => {
        const mesh = new SplatMesh({ url, extSplats: true });
        await mesh.initialized;
        scene.add(mesh);
        return mesh;
    };
    window.exact = async (name, url) => {
        face.mesh.visible = false;
        const mesh = await open(url);
        await keep(name);
        scene.remove(mesh);
        mesh.dispose();
        face.mesh.visible = true;
    };
    window.face = await Bases.load(await open("/head.ply"), "/head.safetensors");
    window.drivers = [...face.drivers.keys()];
    window.ready = true;
    </script>`;

async function main() {
    const b = await Browser.start(chromium, [size + 20, size + 20],
                                  ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]);
    const server = await serve([work]);
    try {
        const { parseBases, driversOf } = await import(at("bases.mjs"));
        const bytes = fs.readFileSync(at("head.safetensors"));
        const bases = parseBases(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
        const float = (h) => (h & 0x8000 ? -1 : 1) * ((h >> 10 & 31) === 0 ? (h & 1023) * 2 ** -24
            : (1024 + (h & 1023)) * 2 ** ((h >> 10 & 31) - 25));
        const cases = casesOf(bases, { float, drivers: driversOf(bases) });
        const versions = ["@sparkjsdev/spark", "three"].map((name) =>
            `${name} ${JSON.parse(fs.readFileSync(at(`node_modules/${name}/package.json`))).version}`);
        console.log(`${(await b.call("Browser.getVersion")).product}; ${versions.join(", ")}; ${os.cpus()[0].model}, ` +
                    `${os.cpus().length} processors`);
        const zipped = (name) => require("node:zlib").gzipSync(fs.readFileSync(at(name))).length;
        for (const name of ["head.spz", "head.ply", "head.safetensors"])
            console.log(`${name}: ${fs.statSync(at(name)).size} bytes, ${zipped(name)} by gzip`);
        console.log(`${bases.gaussians} Gaussians, ${bases.bases.length} bases, ${bases.index.length} entries`);

        // rye's own pictures, one row of drivers each.
        rye_("drivers", "--run", run, "--out", at("drivers.csv"));
        const columns = fs.readFileSync(at("drivers.csv"), "utf8").split("\n")[0].trim().split(",")
            .filter((name) => name !== "frame");
        const named = [...driversOf(bases).keys()].filter((name) => !columns.includes(name));
        const rows = cases.map(([, values]) => [...columns, ...named].map((name) =>
            values[name] ?? (name === "scale" ? 1 : 0)));
        fs.writeFileSync(at("cases.csv"), `${[[...columns, ...named], ...rows].join("\n")}\n`);
        fs.writeFileSync(at("cameras.json"), JSON.stringify({ look_at: [0, 0, 0], up: [0, 1, 0], fov,
                                                              size: [size, size], cameras: [{ eye }] }));
        fs.rmSync(at("pictures"), { recursive: true, force: true });
        rye_("redirect", "--run", run, "--driving", at("cases.csv"), "--cameras", at("cameras.json"), "--view", 0,
             "--out", at("pictures"));

        fs.writeFileSync(at("bases.html"), page);
        await b.call("Page.navigate", { url: `http://127.0.0.1:${server.address().port}/bases.html` });
        await b.until("window.ready === true", 60000);
        await b.evaluate("keep('rest')");
        console.log("PSNR [dB] of Spark's picture:");
        console.log("                                             bases to   bases to   exact to   rest to");
        console.log("                                             exact      rye        rye        exact");
        for (const [k, [what, values]] of cases.entries()) {
            const words = Object.entries(values).filter(([name, x]) => !gazes.includes(name) && x !== undefined);
            const options = words.length > 0 ? ["--expression", words.map(([name, x]) => `${name}=${x}`).join(",")] : [];
            const look = (side) => `${values[`gaze_${side}_pitch`] ?? 0},${values[`gaze_${side}_yaw`] ?? 0}`;
            rye_("export", "--run", run, "--canonical", "--axes", "world", ...options, `--gaze-left=${look("left")}`,
                 `--gaze-right=${look("right")}`, "--out", at("exact.ply"));
            await b.evaluate(`face.set(${JSON.stringify(values)}); keep("bases")`);
            await b.screenshot(at(`pictures/bases_${k}.png`));
            await b.evaluate(`exact("exact", "/exact.ply?${k}")`);
            await b.evaluate(`keepFile("rye", "/pictures/frame_${String(k).padStart(4, "0")}.png")`);
            const got = await b.evaluate(`[psnr("bases", "exact"), psnr("bases", "rye"), psnr("exact", "rye"), psnr("rest", "exact")]`);
            console.log(`${what.padEnd(44)}${got.map((x) => x.toFixed(1).padStart(8)).join("   ")}`);
        }
        // Each picture has new weights, or none has.
        const all = [...driversOf(bases).keys()].filter((name) => !gazes.includes(name));
        const times = async (names, moves) => (await b.evaluate(`(async () => { const times = [];
            const names = ${JSON.stringify(names)};
            for (let i = 0; i < 9; ++i) {
                const begun = performance.now();
                if (${moves}) face.set(Object.fromEntries(names.map((name) => [name, 0.1 + 0.01 * i])));
                draw();
                times.push(performance.now() - begun);
                await new Promise((done) => setTimeout(done, 60));
            }
            return times.sort((x, y) => x - y); })()`));
        console.log("time of a picture, its bytes read [ms]: least, median");
        for (const [what, names, moves] of [["nothing moves", [], false], ["both gazes", gazes, true],
                                            ["one coefficient", all.slice(0, 1), true], ["all", [...all, ...gazes], true]]) {
            const t = await times(names, moves);
            console.log(`${what.padEnd(20)} ${t[0].toFixed(1)}, ${t[t.length >> 1].toFixed(1)}`);
        }
        for (const fault of b.faults.slice(0, 5)) console.log(`  console: ${fault.slice(0, 400)}`);
    } finally {
        await b.end();
        server.close();
    }
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
