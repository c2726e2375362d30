// SPDX-License-Identifier: Apache-2.0
// bases.mjs RYE RUN: what `rye export --bases` writes, read by examples/spark/bases.mjs and applied here, gives
// the splats that rye exports at that expression or gaze, up to the changes that it leaves out. In the
// folder it is started in.
import { execFileSync } from "node:child_process";
import { readFileSync } from "node:fs";
import { driversOf, numbers, parseBases, turnsOf, weightsOf } from "../../examples/spark/bases.mjs";

const [rye, run] = process.argv.slice(2);
const exported = (name, ...words) => {
    execFileSync(rye, ["export", "--run", run, "--out", name, ...words]);
    const bytes = readFileSync(name), end = bytes.indexOf("end_header\n") + 11;
    const names = [...bytes.toString("latin1", 0, end).matchAll(/property float (\w+)/g)].map((m) => m[1]);
    return Array.from({ length: (bytes.length - end) / 4 / names.length }, (_, i) => Object.fromEntries(
        names.map((key, k) => [key, bytes.readFloatLE(end + 4 * (i * names.length + k))])));
};
const half = (h) => (h & 0x8000 ? -1 : 1) * ((h >> 10 & 31) === 0 ? (h & 1023) * 2 ** -24
    : (1024 + (h & 1023)) * 2 ** ((h >> 10 & 31) - 25));
const product = ([aw, ax, ay, az], [bw, bx, by, bz]) => [
    aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw];
const turned = (q, v) => product(product(q, [0, ...v]), q.map((x, k) => k ? -x : x)).slice(1);

/// The centres and rotations of splats that the bases moved to values of drivers.
function moved(splats, bases, values) {
    const changes = splats.map(() => new Float64Array(numbers)), weights = weightsOf(bases, values);
    weights.forEach((weight, b) => {
        for (let e = bases.begin[b]; e < bases.begin[b + 1]; ++e)
            for (let k = 0; k < numbers; ++k)
                changes[bases.index[e]][k] += weight * half(bases.change[numbers * e + k]);
    });
    const turns = turnsOf(bases, values).map(([x, y, z, w]) => [w, x, y, z]);
    return splats.map((s, i) => {
        const c = changes[i], angle = Math.hypot(c[3], c[4], c[5]), f = angle > 0 ? Math.sin(angle / 2) / angle : 0;
        let centre = [s.x + c[0], s.y + c[1], s.z + c[2]];
        let rotation = product([Math.cos(angle / 2), f * c[3], f * c[4], f * c[5]], [s.rot_0, s.rot_1, s.rot_2, s.rot_3]);
        bases.eyes.forEach((eye, e) => {
            if (i < eye.first || i >= eye.first + eye.count) return;
            centre = turned(turns[e], centre.map((x, k) => x - eye.centre[k])).map((x, k) => x + eye.centre[k]);
            rotation = product(turns[e], rotation);
        });
        return { centre, rotation };
    });
}

/// The largest distances [units] and angles [rad] from what rye exported, of splats for which it holds.
function apart(got, right, holds) {
    let distance = 0, angle = 0;
    got.forEach(({ centre: [x, y, z], rotation: q }, i) => {
        if (!holds(i)) return;
        const r = right[i], p = [r.rot_0, r.rot_1, r.rot_2, r.rot_3], dot = q.reduce((s, v, k) => s + v * p[k], 0);
        distance = Math.max(distance, Math.hypot(x - r.x, y - r.y, z - r.z));
        angle = Math.max(angle, 2 * Math.acos(Math.min(1, Math.abs(dot) / Math.hypot(...q) / Math.hypot(...p))));
    });
    return { distance, angle };
}

const rest = exported("rest.ply", "--bases", "bases.safetensors");
const bytes = readFileSync("bases.safetensors");
const bases = parseBases(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
const eyes = (i) => bases.eyes.some(({ first, count }) => i >= first && i < first + count);
const width = Math.max(...["x", "y", "z"].map((k) => {
    const all = rest.map((s) => s[k]);
    return Math.max(...all) - Math.min(...all);
})) / 2;
const drivers = driversOf(bases), faults = [];
const check = (what, { distance, angle }, most, widest) => {
    if (!(distance <= most && angle <= widest))
        faults.push(`${what}: ${distance} units, ${angle} rad; expected at most ${most}, ${widest}`);
};
if (rest.length !== bases.gaussians) faults.push(`${bases.gaussians} Gaussians, expected ${rest.length}`);
check("at rest", apart(moved(rest, bases, {}), rest, () => true), 1e-6, 1e-3);
for (const { driver, at } of bases.bases.filter(({ driver }) => !driver.startsWith("gaze_")).slice(0, 3))
    check(driver, apart(moved(rest, bases, { [driver]: at }), exported("moved.ply", "--expression", `${driver}=${at}`),
                        () => true), 5.1e-3 * width, 0.06);
const looks = { gaze_left_pitch: 7, gaze_left_yaw: -11, gaze_right_pitch: -5, gaze_right_yaw: 13 };
check("a gaze", apart(moved(rest, bases, looks),
                      exported("moved.ply", "--gaze-left=7,-11", "--gaze-right=-5,13"), eyes), 1e-4, 2e-3);
if (drivers.size < 5) faults.push(`${drivers.size} drivers`);
for (const fault of faults) console.error(`FAILED: bases: ${fault}`);
console.log(`bases: ${bases.bases.length} of ${drivers.size} drivers: read and applied`);
process.exit(faults.length > 0 ? 1 : 0);
