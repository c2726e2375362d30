// SPDX-License-Identifier: Apache-2.0
// readers.mjs: compares sweep.usda of this folder with what TinyUSDZ makes of it, and head.ply with
// read.ply, which splat-transform made of head.spz. Started by readers.sh.
import { readFileSync } from 'node:fs';

let bad = false;
const report = (what, difference, bound) => {
    bad ||= !(difference <= bound);
    console.log(`${what}: ${difference.toPrecision(2)}, at most ${bound.toPrecision(2)}`);
};

// The package is for browsers: it runs here if it takes this for one, and is given its module.
globalThis.window = globalThis;
process.type = 'renderer';
const wasm = readFileSync('node_modules/tinyusdz/tinyusdz.wasm');
const tiny = await (await import('tinyusdz/tinyusdz.js')).default({ instantiateWasm: (imports, done) => {
    WebAssembly.instantiate(wasm, imports).then(r => done(r.instance, r.module));
    return {};
} });
const loader = new tiny.TinyUSDZLoaderNative();
const own = readFileSync('sweep.usda');
if (!loader.loadAsLayerFromBinary(new Uint8Array(own), 'sweep.usda')) throw new Error(loader.error());

/// The numbers of each attribute, or of each of its samples: both texts are of the same grammar.
const attributes = text => {
    const found = new Map(), list = t => (t.match(/-?\d+\.?\d*(e[-+]?\d+)?/g) ?? []).map(Number);
    const pattern = /^ +(?:uniform )?\S+ ([\w:]+)(\.timeSamples)? = (\{[^}]*\}|\[[^\]]*\]|\S+)/gm;
    for (const [, name, samples, value] of text.matchAll(pattern)) {
        if (!samples) found.set(name, list(value));
        else for (const [, time, array] of value.matchAll(/(\d+): (\[[^\]]*\])/g))
            found.set(`${name} at ${time}`, list(array));
    }
    return found;
};
const written = attributes(own.toString()), read = attributes(loader.layerToString());
if (written.size < 8 || [...written.keys()].sort().join() !== [...read.keys()].sort().join())
    throw new Error(`attributes: ${[...written.keys()]} and ${[...read.keys()]}`);
let worst = 0;
for (const [name, numbers] of written) {
    const others = read.get(name);
    if (numbers.length !== others.length) throw new Error(`${name}: ${numbers.length}, ${others.length}`);
    numbers.forEach((x, i) => { worst = Math.max(worst, Math.abs(x - others[i]) / (Math.abs(x) + 1e-9)); });
}
report('TinyUSDZ, numbers of sweep.usda, relative', worst, 1e-6);

const columns = file => {
    const bytes = readFileSync(file), end = bytes.indexOf('end_header\n') + 11;
    const header = bytes.subarray(0, end).toString();
    const names = [...header.matchAll(/property float (\S+)/g)].map(m => m[1]);
    const count = Number(/element vertex (\d+)/.exec(header)[1]);
    const at = (i, name) => bytes.readFloatLE(end + 4 * (i * names.length + names.indexOf(name)));
    return { count, at };
};
const a = columns('head.ply'), b = columns('read.ply');
if (a.count !== b.count) throw new Error(`Gaussians: ${a.count} and ${b.count}`);
const largest = (names, f = x => x) => {
    let difference = 0;
    for (let i = 0; i < a.count; ++i)
        for (const n of names) difference = Math.max(difference, Math.abs(f(a.at(i, n)) - f(b.at(i, n))));
    return difference;
};
report('splat-transform, position', largest(['x', 'y', 'z']), 1 / 8192 + 1e-5);
report('splat-transform, log scale within -10 to 5.9',
       largest(['scale_0', 'scale_1', 'scale_2'], x => Math.min(Math.max(x, -10), 5.9)), 1 / 32 + 1e-5);
report('splat-transform, opacity', largest(['opacity'], x => 1 / (1 + Math.exp(-x))), 0.5 / 255 + 1e-5);
report('splat-transform, f_dc within -3.3 to 3.3',
       largest(['f_dc_0', 'f_dc_1', 'f_dc_2'], x => Math.min(Math.max(x, -3.3), 3.3)), 0.0131);
process.exit(bad ? 1 : 0);
