// SPDX-License-Identifier: Apache-2.0
// blend.wgsl: one workgroup blends one tile, an invocation each pixel, front to back, by the
// formulas of rye/splat/blend.hpp with the stop rule `inclusive`:
//     alpha = min(alpha_max, 2^(log2 o - u^2 - v^2))       nothing below the cut
//     weight = alpha T, T becomes T - weight               nothing once T is below `stop`
// Channels are summed `block` at a time; further ones are further workgroups'.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> entries: array<Entry>;
@group(0) @binding(3) var<storage, read> begin: array<u32>;
@group(0) @binding(4) var<storage, read> features: array<f32>;
@group(0) @binding(5) var<storage, read> background: array<f32>;
@group(0) @binding(6) var<storage, read_write> render: array<f32>;

const lanes = tile_edge * tile_edge;
const batch = 128u;
var<workgroup> near: array<Splat, batch>;
var<workgroup> colour: array<f32, batch * block>;
var<workgroup> tile_range: vec2u;
var<workgroup> open: atomic<u32>;
var<workgroup> going: u32;

@compute @workgroup_size(tile_edge, tile_edge)
fn blend(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32,
         @builtin(global_invocation_id) pixel: vec3u) {
    let tile = group.y * frame.columns + group.x;
    let first_channel = group.z * block;
    if (lane == 0u) {
        tile_range = vec2u(begin[tile], begin[tile + 1u]);
    }
    let range = workgroupUniformLoad(&tile_range);
    let inside = pixel.x < frame.width && pixel.y < frame.height;
    let at = vec2f(pixel.xy) + vec2f(0.5) - frame.principal;
    var transmittance = select(0.0, 1.0, inside);
    var sums: array<f32, block>;
    for (var first = range.x; first < range.y; first += batch) {
        let count = min(batch, range.y - first);
        if (lane == 0u) {
            atomicStore(&open, 0u);
        }
        if (lane < count) {
            near[lane] = splats[entries[first + lane].gaussian];
        }
        for (var i = lane; i < count * block; i += lanes) {
            let channel = first_channel + i % block;
            if (channel < channels) {
                colour[i] = features[entries[first + i / block].gaussian * channels + channel];
            }
        }
        workgroupBarrier();
        for (var k = 0u; k < count && transmittance >= frame.stop; k += 1u) {
            let s = near[k];
            let u = s.ux * (at.x - s.x);
            let v = s.vx * (at.x - s.x) + s.vy * (at.y - s.y);
            let exponent = s.log2_opacity - u * u - v * v;
            if (exponent >= frame.cut) {
                let weight = min(frame.alpha_max, exp2(exponent)) * transmittance;
                transmittance -= weight;
                for (var c = 0u; c < block; c += 1u) {
                    sums[c] += weight * colour[k * block + c];
                }
            }
        }
        if (transmittance >= frame.stop && transmittance > 0.0) {
            atomicStore(&open, 1u);
        }
        workgroupBarrier();
        if (lane == 0u) {
            going = atomicLoad(&open);
        }
        if (workgroupUniformLoad(&going) == 0u) {
            break;
        }
    }
    if (!inside) {
        return;
    }
    let to = (pixel.y * frame.width + pixel.x) * channels;
    for (var c = 0u; c < block; c += 1u) {
        if (first_channel + c < channels) {
            render[to + first_channel + c] =
                sums[c] + transmittance * background[first_channel + c];
        }
    }
}
