// SPDX-License-Identifier: Apache-2.0
// convolve.wgsl: a 3 x 3 convolution over zeros beyond the border (rye/nn/convolution.hpp): one
// invocation, one pixel and four outputs. Weights: for each place of the kernel, row by row, for
// each input, its outputs in fours.

@group(0) @binding(0) var<uniform> layer: Layer;
@group(0) @binding(1) var<storage, read> image: array<f32>;
@group(0) @binding(2) var<storage, read> weights: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> result: array<vec4f>;

@compute @workgroup_size(8, 8)
fn convolve(@builtin(global_invocation_id) id: vec3u) {
    if (id.x >= layer.width || id.y >= layer.height) {
        return;
    }
    var sum = vec4f(0.0);
    for (var ky = 0u; ky < 3u; ky += 1u) {
        for (var kx = 0u; kx < 3u; kx += 1u) {
            let x = id.x + kx;                          // counted with a border of one pixel
            let y = id.y + ky;
            if (x < 1u || y < 1u || x > layer.width || y > layer.height) {
                continue;
            }
            let input = ((y - 1u) * layer.width + x - 1u) * layer.stride;
            let by = (3u * ky + kx) * layer.inputs;
            for (var i = 0u; i < layer.inputs; i += 1u) {
                sum += rectify(image[input + i], layer.rectified) *
                       weights[(by + i) * layer.outputs + id.z];
            }
        }
    }
    result[(id.y * layer.width + id.x) * layer.outputs + id.z] = sum;
}
