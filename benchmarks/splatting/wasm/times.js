// SPDX-License-Identifier: Apache-2.0
// times.js WORK COUNT [AVATAR]: times what wasm.sh compiled to WORK for COUNT work trees, in one
// process of node and call by call in turn: the heads of head1.js, head2.js, ..., and with AVATAR
// frames of it by the gaze pages page1, page2, ... Prints CPU times [ms], the least of ROUNDS (31),
// and of each tree after the first the median of its times over those of the first beside them.
"use strict";

const fs = require("node:fs");
const os = require("node:os");
const path = require("node:path");
const vm = require("node:vm");

const [work, trees, avatar] = process.argv.slice(2);
const count = Number(trees), rounds = Number(process.env.ROUNDS ?? 31), warm = 5;

const cpu = () => {
    const { user, system } = process.cpuUsage();
    return (user + system) / 1000;
};
const timed = (call) => {
    const begin = cpu();
    call();
    return cpu() - begin;
};
const median = (x) => [...x].sort((a, b) => a - b)[x.length >> 1];
const few = (x) => (x < 100 ? x.toFixed(2) : x.toFixed(1)).padStart(9);

/// Times calls that belong together, `calls(tree, round)` being a list of them, and prints a line of
/// each of their sums from the first on.
function compare(names, calls) {
    const times = names.map(() => Array.from({ length: count }, () => []));
    for (let round = -warm; round < rounds; ++round)
        for (let tree = 0; tree < count; ++tree) {
            let sum = 0;
            calls(tree, round).forEach((call, i) => {
                sum += timed(call);
                if (round >= 0) times[i][tree].push(sum);
            });
        }
    names.forEach((name, i) => {
        const ratios = times[i].slice(1).map((t) => median(t.map((x, k) => x / times[i][0][k])).toFixed(3).padStart(9));
        console.log(name.padEnd(44) + times[i].map((t) => few(Math.min(...t))).join("") + ratios.join(""));
    });
}

async function heads() {
    const modules = [];
    for (let tree = 1; tree <= count; ++tree) modules.push(await require(path.join(work, `head${tree}.js`))());
    for (const channels of [3, 8, 32])
        for (const gaussians of [20000, 100000]) {
            for (const m of modules) m._head_make(gaussians, channels);
            const what = `${gaussians} Gaussians, ${channels} channels, `;
            compare([`${what}forward`, `${what}forward, gradient`],
                    (tree) => [() => modules[tree]._head_forward(), () => modules[tree]._head_backward()]);
        }
}

/// The page's module, which is one of a worker, with the avatar open.
async function openPage(folder, bytes) {
    const script = fs.readFileSync(path.join(folder, "rye.js"), "utf8");
    const make = vm.runInThisContext(`(() => { ${script}; return ryeModule; })()`);
    const rye = await make({ wasmBinary: fs.readFileSync(path.join(folder, "rye.wasm")) });
    const at = rye._malloc(bytes.length), name = rye._malloc(8);
    rye.stringToUTF8("avatar", name, 8);
    rye.HEAPU8.set(bytes, at);
    if (rye._page_open(name, at, bytes.length, 1) !== 0) throw new Error(rye.UTF8ToString(rye._page_message()));
    rye._free(at);
    return rye;
}

async function pages() {
    globalThis.self = { location: { href: "" } };
    const bytes = fs.readFileSync(avatar), modules = [];
    for (let tree = 1; tree <= count; ++tree) modules.push(await openPage(path.join(work, `page${tree}`), bytes));
    const add = (rye, at, k, x) => { rye.HEAPF32[(at >> 2) + k] += x; };
    const changes = {
        "both gazes": (rye, x) => [0, 1, 2, 3].forEach((k) => add(rye, rye._page_gaze(), k, x)),
        "an expression coefficient": (rye, x) => add(rye, rye._page_expression(), 0, x),
        "the camera": (rye, x) => add(rye, rye._page_motion(), 3, x),
    };
    const draw = (rye) => {
        if (rye._page_draw(-1, 0) !== 0) throw new Error(rye.UTF8ToString(rye._page_message()));
    };
    console.log(`${modules[0]._page_gaussians()} Gaussians, a frame of the page after a change of`);
    for (const size of [256, 512])
        for (const [what, change] of Object.entries(changes)) {
            for (const rye of modules) {
                if (rye._page_size(size, size) !== 0) throw new Error("no memory");
                draw(rye);
            }
            compare([`  ${what}, ${size} x ${size}`], (tree, round) => [() => {
                change(modules[tree], round % 2 === 0 ? 0.01 : -0.01);
                draw(modules[tree]);
            }]);
        }
}

async function main() {
    console.log(`${os.cpus()[0].model}, node ${process.versions.node}, a load of ${os.loadavg()[0].toFixed(1)}; ` +
                `the least of ${rounds} [ms], ratios to the first`);
    await heads();
    if (avatar) await pages();
}

main().catch((fault) => {
    console.error(String(fault.stack || fault).slice(0, 2000));
    process.exit(1);
});
