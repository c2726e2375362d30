// SPDX-License-Identifier: Apache-2.0
// double.wgsl: an image at twice the size, bilinear, the centres of corner pixels on each other
// (rye/nn/bilinear.hpp): one invocation, one pixel of the result.

@group(0) @binding(0) var<uniform> layer: Layer;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read_write> result: array<f32>;

// The two inputs of an output along one axis of n inputs, and the weight of the second.
struct Taps {
    low: u32,
    high: u32,
    share: f32,
}
fn taps(o: u32, n: u32) -> Taps {
    let span = 2u * n - 1u;
    let low = o * (n - 1u) / span;
    return Taps(low, min(low + 1u, n - 1u), f32(o * (n - 1u) % span) / f32(span));
}

@compute @workgroup_size(8, 8)
fn enlarge(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= 2u * layer.width || id.y >= 2u * layer.height) {
        return;
    }
    let across = taps(id.x, layer.width);
    let down = taps(id.y, layer.height);
    let top = down.low * layer.width;
    let bottom = down.high * layer.width;
    let to = (id.y * 2u * layer.width + id.x) * layer.outputs;
    for (var c = 0u; c < layer.inputs; c += 1u) {
        let a = rectify(image[(top + across.low) * layer.stride + c], layer.rectified);
        let b = rectify(image[(bottom + across.low) * layer.stride + c], layer.rectified);
        let e = rectify(image[(top + across.high) * layer.stride + c], layer.rectified);
        let f = rectify(image[(bottom + across.high) * layer.stride + c], layer.rectified);
        let left = (1.0 - down.share) * a + down.share * b;
        let right = (1.0 - down.share) * e + down.share * f;
        result[to + c] = (1.0 - across.share) * left + across.share * right;
    }
}
