// SPDX-License-Identifier: Apache-2.0
// normalize.wgsl: InstanceNorm (rye/nn/instance_norm.hpp): one workgroup brings one channel of an
// image to mean 0 and variance 1, in place. Each invocation adds up every 256th pixel, then these
// sums are added up as a tree: the same bits each time.

@group(0) @binding(0) var<uniform> layer: Layer;
@group(0) @binding(1) var<storage, read_write> image: array<f32>;

const lanes = 256u;
const eps = 1e-5;
var<workgroup> sums: array<f32, lanes>;

fn total(lane: u32, own: f32) -> f32 {
    workgroupBarrier();
    sums[lane] = own;
    for (var half = lanes / 2u; half > 0u; half /= 2u) {
        workgroupBarrier();
        if (lane < half) {
            sums[lane] += sums[lane + half];
        }
    }
    workgroupBarrier();
    return sums[0];
}

@compute @workgroup_size(lanes)
fn normalize_channel(@builtin(workgroup_id) group: vec3u,
                     @builtin(local_invocation_index) lane: u32) {
    let pixels = layer.width * layer.height;
    let channel = group.x;
    var sum = 0.0;
    for (var p = lane; p < pixels; p += lanes) {
        sum += image[p * layer.stride + channel];
    }
    let mean = total(lane, sum) / f32(pixels);
    sum = 0.0;
    for (var p = lane; p < pixels; p += lanes) {
        let x = image[p * layer.stride + channel] - mean;
        sum += x * x;
    }
    let gain = 1.0 / sqrt(total(lane, sum) / f32(pixels) + eps);
    for (var p = lane; p < pixels; p += lanes) {
        let at = p * layer.stride + channel;
        image[at] = (image[at] - mean) * gain;
    }
}
