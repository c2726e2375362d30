// SPDX-License-Identifier: Apache-2.0
// sort.wgsl: one workgroup sorts one tile's list by depth, ties by index, which is the order of
// rye/splat/tile_lists.hpp and the same whatever order the list came in. Bitonic, with the first
// step of each merge mirrored, so that all comparisons are upward and a list of any length needs no
// filling: what would lie beyond its end is never moved. Lists of up to `held` entries are sorted
// in the workgroup's memory, longer ones where they are.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> begin: array<u32>;
@group(0) @binding(2) var<storage, read_write> entries: array<Entry>;

const lanes = 256u;
const held = 2000u;        // of the 16384 bytes that every device has
var<workgroup> near: array<Entry, held>;
var<workgroup> tile_range: vec2u;

fn wrong(a: Entry, b: Entry) -> bool {
    return a.depth > b.depth || (a.depth == b.depth && a.gaussian > b.gaussian);
}

// Returns the pair number i of a step: mirrored in runs of `size`, or `size` / 2 apart.
fn pair_of(i: u32, size: u32, mirrored: bool) -> vec2u {
    let half = size / 2u;
    let first = i / half * size + i % half;
    return vec2u(first, select(first + half, i / half * size + size - 1u - i % half, mirrored));
}

fn settle_near(p: vec2u, n: u32) {
    if (p.y < n && wrong(near[p.x], near[p.y])) {
        let moved = near[p.x];
        near[p.x] = near[p.y];
        near[p.y] = moved;
    }
}

fn settle_far(p: vec2u, first: u32, n: u32) {
    if (p.y < n && wrong(entries[first + p.x], entries[first + p.y])) {
        let moved = entries[first + p.x];
        entries[first + p.x] = entries[first + p.y];
        entries[first + p.y] = moved;
    }
}

@compute @workgroup_size(lanes)
fn sort(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) lane: u32) {
    let tile = group.y * frame.columns + group.x;
    if (lane == 0u) {
        tile_range = vec2u(begin[tile], begin[tile + 1u]);
    }
    let range = workgroupUniformLoad(&tile_range);
    let n = range.y - range.x;
    if (n < 2u) {
        return;
    }
    var whole = 2u;
    while (whole < n) {
        whole *= 2u;
    }
    if (n <= held) {
        for (var i = lane; i < n; i += lanes) {
            near[i] = entries[range.x + i];
        }
        workgroupBarrier();
        for (var run = 2u; run <= whole; run *= 2u) {
            for (var size = run; size > 1u; size /= 2u) {
                for (var i = lane; i < whole / 2u; i += lanes) {
                    settle_near(pair_of(i, size, size == run), n);
                }
                workgroupBarrier();
            }
        }
        for (var i = lane; i < n; i += lanes) {
            entries[range.x + i] = near[i];
        }
        return;
    }
    for (var run = 2u; run <= whole; run *= 2u) {
        for (var size = run; size > 1u; size /= 2u) {
            for (var i = lane; i < whole / 2u; i += lanes) {
                settle_far(pair_of(i, size, size == run), range.x, n);
            }
            storageBarrier();
        }
    }
}
