// SPDX-License-Identifier: Apache-2.0
// lists.wgsl: from the mentions of project.wgsl to a list of each tile: `scan` turns the tiles'
// numbers into the beginnings of their lists, `place` puts each mention into its tile's, in any
// order.

@group(0) @binding(0) var<uniform> frame: Frame;
@group(0) @binding(1) var<storage, read> mentions: array<Mention>;
// For each tile the number of its mentions, after `scan` where its next one goes; then their total.
@group(0) @binding(2) var<storage, read_write> tally: array<atomic<u32>>;
// Tile t holds entries [begin[t], begin[t + 1]).
@group(0) @binding(3) var<storage, read_write> begin: array<u32>;
@group(0) @binding(4) var<storage, read_write> entries: array<Entry>;

const lanes = 256u;
var<workgroup> sums: array<u32, lanes>;

// One workgroup: each invocation adds up a run of tiles, then all add up the runs before theirs.
@compute @workgroup_size(lanes)
fn scan(@builtin(local_invocation_index) lane: u32) {
    let each = (frame.tiles + lanes - 1u) / lanes;
    let first = min(lane * each, frame.tiles);
    let last = min(first + each, frame.tiles);
    var sum = 0u;
    for (var t = first; t < last; t += 1u) {
        sum += atomicLoad(&tally[t]);
    }
    sums[lane] = sum;
    for (var step = 1u; step < lanes; step *= 2u) {
        workgroupBarrier();
        var before = 0u;
        if (lane >= step) {
            before = sums[lane - step];
        }
        workgroupBarrier();
        sums[lane] += before;
    }
    workgroupBarrier();
    var next = sums[lane] - sum;
    for (var t = first; t < last; t += 1u) {
        let count = atomicLoad(&tally[t]);
        begin[t] = next;
        atomicStore(&tally[t], next);
        next += count;
    }
    if (lane == lanes - 1u) {
        begin[frame.tiles] = next;
    }
}

@compute @workgroup_size(lanes)
fn place(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let total = min(atomicLoad(&tally[frame.tiles]), frame.most);
    for (var i = id.x; i < total; i += groups.x * lanes) {
        let m = mentions[i];
        let at = atomicAdd(&tally[m.tile], 1u);
        entries[at] = Entry(m.depth, m.gaussian);
    }
}
