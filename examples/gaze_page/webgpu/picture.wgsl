// SPDX-License-Identifier: Apache-2.0
// picture.wgsl: the last layer of the network (rye/nn/upsampler.hpp), and its picture in bytes:
// red, green, blue, and 255.

@group(0) @binding(0) var<uniform> layer: Layer;
@group(0) @binding(1) var<storage, read> image: array<f32>;
// 3 numbers for each input, then 3 that are added.
@group(0) @binding(2) var<storage, read> weights: array<f32>;
// The render, enlarged: `outputs` numbers a pixel, of which the first three are the odds that the
// network multiplies; 0 numbers: it multiplies none.
@group(0) @binding(3) var<storage, read> base: array<f32>;
@group(0) @binding(4) var<storage, read_write> bytes: array<u32>;

// Returns b e^z / (b e^z + 1 - b), without overflow of the exponential.
fn odds(b: vec3f, z: vec3f) -> vec3f {
    let e = exp(-abs(z));
    let p = select(b, b * e, z < vec3f(0.0));
    let q = select((1.0 - b) * e, 1.0 - b, z < vec3f(0.0));
    return p / (p + q);
}

@compute @workgroup_size(8, 8)
fn finish(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= layer.cut_width || id.y >= layer.cut_height) {
        return;
    }
    let pixel = id.y * layer.width + id.x;
    var z = vec3f(0.0);
    for (var i = 0u; i < layer.inputs; i += 1u) {
        z += max(image[pixel * layer.stride + i], 0.0) *
             vec3f(weights[3u * i], weights[3u * i + 1u], weights[3u * i + 2u]);
    }
    let b = 3u * layer.inputs;
    z += vec3f(weights[b], weights[b + 1u], weights[b + 2u]);
    var low = vec3f(0.5);      // odds of 1: the sigmoid
    if (layer.outputs > 0u) {
        let at = pixel * layer.outputs;
        low = clamp(vec3f(base[at], base[at + 1u], base[at + 2u]), vec3f(0.001), vec3f(0.999));
    }
    let level = vec3u(clamp(odds(low, z), vec3f(0.0), vec3f(1.0)) * 255.0 + 0.5);
    bytes[id.y * layer.cut_width + id.x] =
        level.x | (level.y << 8u) | (level.z << 16u) | (255u << 24u);
}
