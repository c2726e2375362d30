// SPDX-License-Identifier: Apache-2.0
// project.wgsl: one invocation projects one Gaussian, and names it to the tiles that it reaches.
// The formulas are those of rye/gaussian/project.hpp, rye/math/linalg.hpp, rye/splat/falloff.hpp
// and, for the tiles, rye/splat/tiles.hpp with the support `ellipse`. The order in which tiles are
// named differs from run to run; sort.wgsl puts that right.

@group(0) @binding(0) var<uniform> frame: Frame;
// Means (3 N), quaternions (4 N), scales (3 N), opacities (N).
@group(0) @binding(1) var<storage, read> shape: array<f32>;
@group(0) @binding(2) var<storage, read_write> splats: array<Splat>;
@group(0) @binding(3) var<storage, read_write> mentions: array<Mention>;
// For each tile the number of its mentions; then that of all.
@group(0) @binding(4) var<storage, read_write> tally: array<atomic<u32>>;

const fold = 0.84932180028801904272;
const unfold = 1.17741002251547469101;
const epsilon = 1.1920929e-7;
const large = 0.25 * 3.40282347e38;

fn turned(v: vec3f) -> vec3f {
    return vec3f(dot(frame.row_x.xyz, v), dot(frame.row_y.xyz, v), dot(frame.row_z.xyz, v));
}

// Returns the axes of a quaternion (w, x, y, z) of any norm; 0 is the identity.
fn axes_of(q: vec4f) -> mat3x3f {
    let size = max(max(abs(q.x), abs(q.y)), max(abs(q.z), abs(q.w)));
    if (size == 0.0) {
        return mat3x3f(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    }
    let s = q / size;
    let n = s / sqrt(dot(s, s));
    let w = n.x;
    let x = n.y;
    let y = n.z;
    let z = n.w;
    return mat3x3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                   2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                   2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Returns the pixels of a row or column whose centres lie in [low, high], as [begin, end).
fn pixels_between(low: f32, high: f32, size: f32) -> vec2f {
    let begin = ceil(min(size, max(0.0, low - 0.5)));
    let end = floor(min(size, max(-1.0, high - 0.5))) + 1.0;
    return vec2f(begin, min(size, end));
}

fn mention(row: u32, begin: u32, end: u32, depth: u32, gaussian: u32) {
    let count = end - begin;
    let first = atomicAdd(&tally[frame.tiles], count);
    if (first + count > frame.most) {
        return;                // the total says so, and all is drawn again with more room
    }
    for (var i = 0u; i < count; i += 1u) {
        let tile = row * frame.columns + begin + i;
        atomicAdd(&tally[tile], 1u);
        mentions[first + i] = Mention(tile, depth, gaussian);
    }
}

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    let n = frame.gaussians;
    if (i >= n) {
        return;
    }
    let mean = vec3f(shape[3u * i], shape[3u * i + 1u], shape[3u * i + 2u]);
    let point = turned(mean) + vec3f(frame.row_x.w, frame.row_y.w, frame.row_z.w);
    let opacity = shape[10u * n + i];
    if (!(point.z > frame.near_depth) || !(opacity > 0.0)) {
        return;
    }
    let inverse_depth = 1.0 / point.z;
    let slope = point.xy * inverse_depth;
    let limited = clamp(slope, frame.slope_low, frame.slope_high);
    let per_unit = frame.focal * inverse_depth;
    let toward_x = per_unit.x * (frame.row_x.xyz - limited.x * frame.row_z.xyz);
    let toward_y = per_unit.y * (frame.row_y.xyz - limited.y * frame.row_z.xyz);
    let q = 3u * n + 4u * i;
    let axes = axes_of(vec4f(shape[q], shape[q + 1u], shape[q + 2u], shape[q + 3u]));
    let s = 7u * n + 3u * i;
    let scale = vec3f(shape[s], shape[s + 1u], shape[s + 2u]);
    let x = vec3f(dot(toward_x, axes[0]), dot(toward_x, axes[1]), dot(toward_x, axes[2])) * scale;
    let y = vec3f(dot(toward_y, axes[0]), dot(toward_y, axes[1]), dot(toward_y, axes[2])) * scale;

    let d = frame.dilation;
    let xx = dot(x, x) + d;
    let xy = dot(x, y);
    let yy = dot(y, y) + d;
    let normal = cross(x, y);
    let determinant = dot(normal, normal) + d * (dot(x, x) + dot(y, y)) + d * d;
    let centre = frame.focal * slope;
    if (!(xx + yy + determinant < large) || !(determinant * large > 1.0) ||
        !(dot(centre, centre) < large)) {
        return;
    }
    let log2_opacity = log2(opacity);
    if (!(log2_opacity > frame.cut)) {
        return;
    }
    let vy = fold * sqrt(xx / determinant);
    splats[i] = Splat(centre.x, centre.y, fold / sqrt(xx), -vy * (xy / xx), vy, log2_opacity);

    // The ellipse where the exponent is not below the cut, a little larger for rounding.
    let radius = unfold * (1.0 + 16.0 * epsilon) * sqrt(max(0.0, log2_opacity - frame.cut));
    let at = centre + frame.principal;
    let wide = radius * sqrt(xx);
    let high = radius * sqrt(yy);
    let slack = 8.0 * epsilon * (abs(at.x) + abs(at.y) + wide + high + 1.0);
    let size = vec2f(f32(frame.width), f32(frame.height));
    let rows = pixels_between(at.y - (high + slack), at.y + (high + slack), size.y);
    if (!(rows.x < rows.y)) {
        return;
    }
    let inverse_yy = 1.0 / yy;
    let tilt = xy * inverse_yy;                         // slope of the ellipse's middle line
    let widest = radius * xy / sqrt(xx);                // y of the rightmost point
    let left_over = determinant * inverse_yy;
    let depth = bitcast<u32>(point.z);
    let edge = f32(tile_edge);
    let last = u32(rows.y - 1.0) / tile_edge;
    for (var row = u32(rows.x) / tile_edge; row <= last; row += 1u) {
        let low = max(f32(row) * edge, rows.x) + 0.5 - at.y;
        let high_end = min(f32(row + 1u) * edge, rows.y) - 0.5 - at.y;
        let ends = clamp(vec2f(-widest, widest), vec2f(low), vec2f(high_end));
        let rest = max(vec2f(0.0), radius * radius - ends * ends * inverse_yy);
        let reach = sqrt(rest * left_over) * vec2f(-1.0, 1.0) + tilt * ends;
        let columns = pixels_between(at.x + reach.x - slack, at.x + reach.y + slack, size.x);
        if (columns.x < columns.y) {
            mention(row, u32(columns.x) / tile_edge, u32(columns.y - 1.0) / tile_edge + 1u, depth,
                    i);
        }
    }
}
