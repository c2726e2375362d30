// SPDX-License-Identifier: Apache-2.0
// bases.mjs: the bases that `rye export --bases` writes beside a splat file: read, and what expressions
// and gazes make of them. It needs no other file; spark.mjs gives them to a SplatMesh of Spark.

/// Numbers of a change: centre, rotation vector, logarithms of the scales, colour, opacity.
export const numbers = 13;

/// Returns the bases in the bytes of a file, an ArrayBuffer. Throws an Error for another file.
export function parseBases(buffer, name = "bases") {
    const fail = (what) => { throw new Error(`${name}: ${what}`); };
    const view = new DataView(buffer);
    const length = buffer.byteLength < 8 ? 0 : Number(view.getBigUint64(0, true));
    if (length < 2 || length > buffer.byteLength - 8) fail("not a safetensors file");
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
    const words = header.__metadata__ ?? {};
    if (words.format !== "rye-bases" || words.version !== "1")
        fail(`got the format ${words.format} ${words.version}, expected rye-bases 1`);
    const array = (key, type, Kind) => {
        const { dtype, data_offsets: [begin, end] = [] } = header[key] ?? fail(`no tensor ${key}`);
        if (dtype !== type) fail(`${key}: got ${dtype}, expected ${type}`);
        return new Kind(buffer, 8 + length + begin, (end - begin) / Kind.BYTES_PER_ELEMENT);
    };
    const [bases, eyes, head] = ["bases", "eyes", "head"].map((key) => JSON.parse(words[key]));
    const read = { gaussians: Number(words.gaussians), bases, eyes, head,
                   begin: array("begin", "U32", Uint32Array), index: array("index", "U32", Uint32Array),
                   change: array("change", "F16", Uint16Array) };
    if (read.begin.length !== bases.length + 1 || read.change.length !== numbers * read.index.length)
        fail("its tensors do not belong together");
    return read;
}

/// Returns the drivers that move something, by name: lowest and highest value of training, and rest.
export function driversOf({ bases, eyes }) {
    const drivers = new Map();
    const at = (name, rest) => drivers.get(name) ?? drivers.set(name, { low: rest, rest, high: rest }).get(name);
    eyes.forEach(({ gaze }, e) => ["pitch", "yaw"].forEach((angle, k) => at(gazeName(e, angle), gaze[k])));
    for (const b of bases) {
        const d = at(b.driver, b.rest);
        d.low = Math.min(d.low, b.at);
        d.high = Math.max(d.high, b.at);
    }
    return drivers;
}
const gazeName = (eye, angle) => `gaze_${["left", "right"][eye]}_${angle}`;

/// Returns the weight of each basis, for values of drivers by name; those left out are at rest.
export function weightsOf({ bases }, values) {
    return Float32Array.from(bases, ({ driver, rest, at }) =>
        Math.max(0, ((values[driver] ?? rest) - rest) / (at - rest)));
}

/// Returns the rotation of each eye from rest, a quaternion (x, y, z, w) in the file's axes.
export function turnsOf({ eyes, head }, values) {
    const [w, x, y, z] = head, to = [x, y, z, w], back = [-x, -y, -z, w];
    return eyes.map(({ gaze, kappa }, e) => {
        const looks = ["pitch", "yaw"].map((angle, k) => values[gazeName(e, angle)] ?? gaze[k]);
        const rest = arc(gaze[0] + kappa[0], gaze[1] + kappa[1]);
        const turn = product(arc(looks[0] + kappa[0], looks[1] + kappa[1]), rest.map((q, k) => k < 3 ? -q : q));
        return product(product(to, turn), back);
    });
}

/// The smallest rotation from straight ahead to a gaze, in degrees.
function arc(pitch, yaw) {
    const p = pitch * Math.PI / 180, y = yaw * Math.PI / 180;
    const x = Math.cos(p) * Math.sin(y), up = Math.sin(p), z = Math.cos(p) * Math.cos(y);
    const length = Math.hypot(up, x, 1 + z);
    return [-up / length, x / length, 0, (1 + z) / length];
}

function product([ax, ay, az, aw], [bx, by, bz, bw]) {
    return [aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz];
}
