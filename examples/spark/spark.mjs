// SPDX-License-Identifier: Apache-2.0
// spark.mjs: a SplatMesh of Spark 2 (@sparkjsdev/spark) whose splats move by bases (bases.mjs), on the
// graphics card: a modifier adds to each splat what the bases with a weight have for it, and turns the
// eyes about their centres. The mesh must keep the file's order of splats: no level of detail, no pages.
import * as THREE from "three";
import { dyno } from "@sparkjsdev/spark";
import { driversOf, numbers, parseBases, turnsOf, weightsOf } from "./bases.mjs";

const width = 2048; // of textures, texels; even, so that both texels of an entry are in a row

/// Bases on a SplatMesh; `drivers` maps names to { low, rest, high }.
export class Bases {
    /// Loads a file, by its address, onto a mesh of the splat file that was written with it. The file may
    /// be packed by gzip.
    static async load(mesh, url) {
        const answer = await fetch(url);
        if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
        const bases = parseBases(await unpacked(await answer.arrayBuffer()), String(url));
        await mesh.initialized;
        const count = mesh.splats?.getNumSplats() ?? mesh.numSplats;
        if (count !== bases.gaussians)
            throw new Error(`${url}: of ${bases.gaussians} splats, but the mesh has ${count}`);
        return new Bases(mesh, bases);
    }

    constructor(mesh, bases) {
        this.mesh = mesh;
        this.bases = bases;
        this.drivers = driversOf(bases);
        const weights = new THREE.DataTexture(new Float32Array(Math.max(1, bases.bases.length)),
                                              Math.max(1, bases.bases.length), 1, THREE.RedFormat, THREE.FloatType);
        this.weights = weights;
        this.turns = bases.eyes.map(() => dyno.dynoVec4(new THREE.Quaternion()));
        const { lists, entries } = texturesOf(bases);
        const modifier = morph(bases, {
            lists: dyno.dynoUsampler2D(lists), entries: dyno.dynoUsampler2D(entries),
            weights: dyno.dynoSampler2D(weights), left: this.turns[0], right: this.turns[1] });
        mesh.objectModifiers = [modifier, ...(mesh.objectModifiers ?? [])];
        this.set({});
        mesh.updateGenerator();
    }

    /// Moves the splats to values of drivers by name, such as { jawOpen: 0.5, gaze_left_yaw: 10 };
    /// what is left out is at rest. Gazes are degrees.
    set(values) {
        for (const name of Object.keys(values))
            if (!this.drivers.has(name)) throw new RangeError(`${name}: no such driver of the bases`);
        this.weights.image.data.set(weightsOf(this.bases, values));
        this.weights.needsUpdate = true;
        turnsOf(this.bases, values).forEach((q, e) => this.turns[e].value.set(...q));
        this.mesh.updateVersion();
    }
}

function unpacked(buffer) {
    const bytes = new Uint8Array(buffer, 0, Math.min(2, buffer.byteLength));
    if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) return buffer;
    return new Response(new Blob([buffer]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

function texture(data, channels, format, type, internal) {
    const t = new THREE.DataTexture(data, width, data.length / channels / width, format, type);
    t.internalFormat = internal;
    t.needsUpdate = true;
    return t;
}

/// Returns the entries by splat: `lists`, the first entry and the number of each splat's, and
/// `entries`, two texels each: twelve halves and one, and the basis.
function texturesOf({ gaussians, bases, begin, index, change }) {
    const rows = (texels) => Math.max(1, Math.ceil(texels / width));
    const lists = new Uint32Array(2 * width * rows(gaussians));
    for (const i of index) ++lists[2 * i + 1];
    for (let i = 0, first = 0; i < gaussians; ++i) {
        lists[2 * i] = first;
        first += lists[2 * i + 1];
        lists[2 * i + 1] = 0;
    }
    const entries = new Uint32Array(4 * width * rows(2 * index.length)), halves = new Uint16Array(entries.buffer);
    for (let b = 0; b < bases.length; ++b)
        for (let e = begin[b]; e < begin[b + 1]; ++e) {
            const to = lists[2 * index[e]] + lists[2 * index[e] + 1]++;
            halves.set(change.subarray(numbers * e, numbers * (e + 1)), 16 * to);
            entries[8 * to + 7] = b;
        }
    return { lists: texture(lists, 2, THREE.RGIntegerFormat, THREE.UnsignedIntType, "RG32UI"),
             entries: texture(entries, 4, THREE.RGBAIntegerFormat, THREE.UnsignedIntType, "RGBA32UI") };
}

const functions = `
    vec4 ryeProduct(vec4 a, vec4 b) {
        return vec4(a.w * b.xyz + b.w * a.xyz + cross(a.xyz, b.xyz), a.w * b.w - dot(a.xyz, b.xyz));
    }
    vec3 ryeTurn(vec4 q, vec3 v) {
        return v + 2.0 * cross(q.xyz, cross(q.xyz, v) + q.w * v);
    }
    ivec2 ryeTexel(int i) {
        return ivec2(i % ${width}, i / ${width});
    }`;

/// Returns the modifier of splats.
function morph({ eyes }, uniforms) {
    const point = ({ centre }) => `vec3(${centre.map((x) => x.toExponential()).join(", ")})`;
    const turn = (eye, q, splat) => `
        if (${splat}.index >= ${eye.first} && ${splat}.index < ${eye.first + eye.count}) {
            ${splat}.center = ${point(eye)} + ryeTurn(${q}, ${splat}.center - ${point(eye)});
            ${splat}.quaternion = ryeProduct(${q}, ${splat}.quaternion);
        }`;
    const statements = ({ inputs, outputs: { gsplat } }) => `
        ${gsplat} = ${inputs.gsplat};
        if (isGsplatActive(${gsplat}.flags)) {
            uvec4 list = texelFetch(${inputs.lists}, ryeTexel(${gsplat}.index), 0);
            vec3 centre = vec3(0.0), turn = vec3(0.0), grow = vec3(0.0);
            vec4 colour = vec4(0.0);
            for (uint e = list.x; e < list.x + list.y; ++e) {
                uvec4 last = texelFetch(${inputs.entries}, ryeTexel(int(2u * e + 1u)), 0);
                float weight = texelFetch(${inputs.weights}, ivec2(last.w, 0), 0).x;
                if (weight == 0.0) continue;
                uvec4 first = texelFetch(${inputs.entries}, ryeTexel(int(2u * e)), 0);
                vec2 b = unpackHalf2x16(first.y), c = unpackHalf2x16(first.w), d = unpackHalf2x16(last.x);
                centre += weight * vec3(unpackHalf2x16(first.x), b.x);
                turn += weight * vec3(b.y, unpackHalf2x16(first.z));
                grow += weight * vec3(c, d.x);
                colour += weight * vec4(d.y, unpackHalf2x16(last.y), unpackHalf2x16(last.z).x);
            }
            float angle = length(turn);
            vec3 axis = angle > 1e-6 ? turn * (sin(0.5 * angle) / angle) : 0.5 * turn;
            ${gsplat}.center += centre;
            ${gsplat}.quaternion = ryeProduct(vec4(axis, cos(0.5 * angle)), ${gsplat}.quaternion);
            ${gsplat}.scales *= exp(grow);
            ${gsplat}.rgba = vec4(${gsplat}.rgba.rgb + colour.rgb, clamp(${gsplat}.rgba.a + colour.a, 0.0, 1.0));
            ${turn(eyes[0], inputs.left, gsplat)}
            ${turn(eyes[1], inputs.right, gsplat)}
        }`.split("\n");
    return dyno.dynoBlock({ gsplat: dyno.Gsplat }, { gsplat: dyno.Gsplat }, ({ gsplat }) => {
        const moved = dyno.dyno({
            inTypes: { gsplat: dyno.Gsplat, lists: "usampler2D", entries: "usampler2D", weights: "sampler2D",
                       left: "vec4", right: "vec4" },
            outTypes: { gsplat: dyno.Gsplat },
            globals: () => [functions],
            statements,
        });
        return { gsplat: moved.apply({ gsplat, ...uniforms }).gsplat };
    });
}
