// SPDX-License-Identifier: Apache-2.0
// view.mjs CHROMIUM: shows head.{ply,splat,spz,glb} of this folder in viewers for browsers, each in a
// page of headless chromium with WebGL in software, saves the pictures, and prints the PSNR of each
// against rye_*.png over all pixels and channels. Started by viewers.sh.
import { createServer } from 'node:http';
import { existsSync, readFileSync, writeFileSync } from 'node:fs';
import { extname, join, normalize } from 'node:path';
import { chromium } from 'playwright-core';

const size = 512;
const types = { '.html': 'text/html', '.js': 'text/javascript', '.mjs': 'text/javascript',
                '.png': 'image/png', '.webp': 'image/webp', '.wasm': 'application/wasm' };

const importmap = `<script type="importmap">{"imports": {
  "three": "/node_modules/three/build/three.module.js",
  "three/addons/": "/node_modules/three/examples/jsm/",
  "spark": "/node_modules/@sparkjsdev/spark/dist/spark.module.js"}}</script>`;
const page = (body, head = '') => `<!doctype html><html><head>${importmap}${head}<style>
  html, body { margin: 0; background: #000; overflow: hidden }
  canvas { display: block; width: ${size}px; height: ${size}px }</style></head>
  <body>${body}</body></html>`;
const module = text => `<script type="module">${text}</script>`;

// Each sets window.frames once its picture has been drawn that often with the splats sorted. The
// camera is at (0, 0, -10) of the PLY's axes, which is (0, 0, 10) where y is up.
const viewers = {
    'Spark': file => page(module(`
        import * as THREE from 'three';
        import { SplatMesh, SparkRenderer } from 'spark';
        const camera = new THREE.PerspectiveCamera(18, 1, 0.1, 500);
        camera.position.set(0, 0, 10);
        const renderer = new THREE.WebGLRenderer({antialias: false});
        renderer.setSize(${size}, ${size});
        document.body.appendChild(renderer.domElement);
        const scene = new THREE.Scene();
        scene.add(new SparkRenderer({renderer}));
        const splats = new SplatMesh({url: '/${file}'});
        // It shows stored axes: those of an SPZ are upright, a PLY and a .splat are turned.
        if (!'${file}'.endsWith('.spz')) splats.quaternion.set(1, 0, 0, 0);
        scene.add(splats);
        await splats.initialized;
        window.frames = 0;
        renderer.setAnimationLoop(() => { renderer.render(scene, camera); ++window.frames; });`)),
    'Babylon.js': file => page('<canvas id="c" width="512" height="512"></canvas><script>' + `
        (async () => {
        const engine = new BABYLON.Engine(document.getElementById('c'), false);
        const scene = new BABYLON.Scene(engine);
        scene.useRightHandedSystem = true;
        scene.clearColor = new BABYLON.Color4(0, 0, 0, 1);
        const camera = new BABYLON.FreeCamera('c', new BABYLON.Vector3(0, 0, 10), scene);
        camera.setTarget(BABYLON.Vector3.Zero());
        camera.fov = 18 * Math.PI / 180; camera.minZ = 0.1;
        await BABYLON.ImportMeshAsync('/${file}', scene);
        window.frames = 0;
        engine.runRenderLoop(() => { scene.render(); ++window.frames; });
        })().catch(e => { window.fault = String(e); });</script>`,
        '<script src="/node_modules/babylonjs/babylon.js"></script>' +
        '<script src="/node_modules/babylonjs-loaders/babylonjs.loaders.js"></script>'),
};

// viewer, file, picture of rye, least PSNR [dB]. Viewers for browsers round and clamp colours and cut
// splats in ways of their own, so that their bounds only tell a right picture from a wrong one.
const cases = [
    ['Spark', 'head.ply', 'rye_ply.png', 25], ['Spark', 'head.splat', 'rye_splat.png', 30],
    ['Spark', 'head.spz', 'rye_spz.png', 25],
    ['Babylon.js', 'head.glb', 'rye_ply.png', 25],
];

const server = createServer((request, response) => {
    const path = normalize(decodeURIComponent(request.url.split('?')[0])).replace(/^\/+/, '');
    const shown = /^page(\d+)$/.exec(path);
    if (shown) {
        const [viewer, file] = cases[Number(shown[1])];
        response.writeHead(200, { 'Content-Type': 'text/html' });
        response.end(viewers[viewer](file));
    } else if (path === 'blank' || !existsSync(join('.', path)) || path === '') {
        response.writeHead(path === 'blank' ? 200 : 404, { 'Content-Type': 'text/html' });
        response.end('');
    } else {
        response.writeHead(200, { 'Content-Type': types[extname(path)] ?? 'application/octet-stream' });
        response.end(readFileSync(join('.', path)));
    }
});
await new Promise(done => server.listen(0, '127.0.0.1', done));
const base = `http://127.0.0.1:${server.address().port}`;
const browser = await chromium.launch({ executablePath: process.argv[2], args: [
    '--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader'] });
const context = await browser.newContext({ viewport: { width: size, height: size } });

// Pictures are decoded by the browser, whatever their format.
const compare = await context.newPage();
await compare.goto(base + '/blank');
const psnr = (a, b) => compare.evaluate(async ([a, b]) => {
    const pixels = async url => {
        const image = await createImageBitmap(await (await fetch(url)).blob());
        const canvas = new OffscreenCanvas(image.width, image.height);
        const context = canvas.getContext('2d');
        context.drawImage(image, 0, 0);
        return context.getImageData(0, 0, image.width, image.height).data;
    };
    const [x, y] = [await pixels(a), await pixels(b)];
    if (x.length !== y.length) throw new Error(`${a} and ${b} differ in size`);
    let sum = 0, n = 0, brightest = 0;
    for (let i = 0; i < x.length; ++i) {
        if (i % 4 === 3) continue;
        sum += (x[i] - y[i]) ** 2; ++n;
        brightest = Math.max(brightest, x[i], y[i]);
    }
    if (brightest < 30) throw new Error(`${a} and ${b} are black`);
    return sum === 0 ? Infinity : 10 * Math.log10(255 * 255 * n / sum);
}, [`${base}/${a}`, `${base}/${b}`]);

let bad = 0;
const report = (viewer, file, against, value, least) => {
    const low = !(value >= least);
    console.log(`${viewer.padEnd(18)}${file.padEnd(12)}${against.padEnd(22)}` +
                `${value.toFixed(1).padStart(5)} dB${low ? `, expected at least ${least}` : ''}`);
    bad += low;
};
console.log('viewer            file        against              PSNR');
for (const kind of ['ply', 'splat', 'spz', 'scene']) {
    if (!existsSync(`transform_${kind}.webp`)) continue;
    for (const [floor, least] of [['', 35], ['_floor', 60]])
        report('splat-transform', kind === 'scene' ? 'SCENE' : `head.${kind}`, `rye_${kind}${floor}.png`,
               await psnr(`transform_${kind}.webp`, `rye_${kind}${floor}.png`), least);
}
for (const [index, [viewer, file, against, least]] of cases.entries()) {
    const shown = await context.newPage();
    const faults = [];
    shown.on('pageerror', e => faults.push(String(e)));
    shown.on('console', m => { if (m.type() === 'error') faults.push(m.text()); });
    const name = `${viewer.toLowerCase().replace(/\W/g, '')}_${file.replace('.', '_')}.png`;
    try {
        await shown.goto(`${base}/page${index}`);
        await shown.waitForFunction(() => window.frames >= 3 || window.fault, null, { timeout: 60000 });
        await shown.waitForTimeout(4000);  // sorting runs beside the frames
        writeFileSync(name, await shown.screenshot());
        report(viewer, file, against, await psnr(name, against), least);
    } catch (e) {
        console.log(`${viewer.padEnd(18)}${file.padEnd(12)}${String(e).split('\n')[0]}`);
        ++bad;
    }
    for (const fault of faults.slice(0, 3)) console.log(`    its console: ${fault.slice(0, 200)}`);
    await shown.close();
}
await browser.close();
server.close();
process.exit(bad > 0 ? 1 : 0);
