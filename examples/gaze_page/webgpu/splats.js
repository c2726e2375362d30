// SPDX-License-Identifier: Apache-2.0
// splats.js: a render of Gaussians, from their arrays to features: frame.wgsl, and the steps project,
// scan, place, sort and blend. The tiles' lists get more room where a frame needs it.
"use strict";

class RyeSplats {
    /// For so many Gaussians of so many channels.
    static async make(gpu, gaussians, channels) {
        const s = new RyeSplats();
        const block = Math.min(channels, 16), constants = { channels, block };
        Object.assign(s, { gpu, gaussians, channels, blocks: Math.ceil(channels / block) });
        s.most = 1 << 18;      ///< mentions that there is room for
        const files = { project: "project", scan: "lists", place: "lists", sort: "sort", blend: "blend" };
        s.pipelines = {};
        for (const [entry, file] of Object.entries(files))
            s.pipelines[entry] = await gpu.pipeline(["frame", file], entry, constants);
        s.frame = gpu.holding(new Uint8Array(128), GPUBufferUsage.UNIFORM);
        s.shape = gpu.storage(44 * gaussians);
        s.splats = gpu.storage(24 * gaussians);
        s.features = gpu.storage(4 * channels * gaussians);
        s.background = gpu.storage(4 * channels);
        return s;
    }

    /// Makes the steps for a size [px]; true if they, and the buffer `render`, are new.
    resize(width, height) {
        const key = `${width} ${height} ${this.most}`;
        if (this.key === key) return false;
        const { gpu, pipelines: p, most } = this;
        for (const name of ["mentions", "entries", "tally", "begin", "render"]) this[name]?.destroy();
        const columns = Math.ceil(width / 16), rows = Math.ceil(height / 16), tiles = columns * rows;
        this.mentions = gpu.storage(12 * most);
        this.entries = gpu.storage(8 * most);
        this.tally = gpu.storage(4 * (tiles + 1), GPUBufferUsage.COPY_SRC);
        this.begin = gpu.storage(4 * (tiles + 1));
        this.render = gpu.storage(4 * this.channels * width * height, GPUBufferUsage.COPY_SRC);
        const { frame, shape, splats, mentions, tally, begin, entries } = this;
        this.steps = [
            gpu.step(p.project, [frame, shape, splats, mentions, tally], [Math.ceil(this.gaussians / 64)]),
            gpu.step(p.scan, [frame, null, tally, begin], [1]),
            gpu.step(p.place, [frame, mentions, tally, null, entries], [256]),
            gpu.step(p.sort, [frame, begin, entries], [columns, rows]),
            gpu.step(p.blend, [frame, splats, entries, begin, this.features, this.background, this.render],
                     [columns, rows, this.blocks]),
        ];
        Object.assign(this, { key, width, height, columns, tiles });
        return true;
    }

    /// Hands over the Gaussians: arrays of means, quaternions, scales, opacities and features. Those
    /// that have the `moves` of the last ones are there already.
    move({ mean, rotation, scale, opacity, feature, moves }) {
        if (moves !== undefined && moves === this.moves) return;
        this.moves = moves;
        const { queue } = this.gpu.device, n = this.gaussians;
        queue.writeBuffer(this.shape, 0, mean);
        queue.writeBuffer(this.shape, 12 * n, rotation);
        queue.writeBuffer(this.shape, 28 * n, scale);
        queue.writeBuffer(this.shape, 40 * n, opacity);
        queue.writeBuffer(this.features, 0, feature);
    }

    /// Hands over the camera { motion, fx, fy, cx, cy, width, height, near }, the numbers of the
    /// accuracy { alphaMin, alphaMax, stop, dilation, margin } and the feature behind all.
    look(camera, rules, background) {
        const { fx, fy, cx, cy, width, height } = camera;
        const beyond = [0.5 * width * rules.margin, 0.5 * height * rules.margin];
        const floats = new Float32Array(32), whole = new Uint32Array(floats.buffer);
        floats.set(camera.motion.slice(0, 12));
        floats.set([fx, fy, cx, cy, (-cx - beyond[0]) / fx, (-cy - beyond[1]) / fy,
                    (width - cx + beyond[0]) / fx, (height - cy + beyond[1]) / fy], 12);
        floats.set([camera.near, rules.dilation, Math.log2(rules.alphaMin), rules.alphaMax, rules.stop], 20);
        whole.set([this.gaussians, width, height, this.columns, this.tiles, this.most], 25);
        this.gpu.device.queue.writeBuffer(this.frame, 0, floats);
        this.gpu.device.queue.writeBuffer(this.background, 0, background);
    }

    /// Adds a render to the commands.
    draw(commands) {
        commands.clearBuffer(this.tally);
        const pass = commands.beginComputePass();
        for (const step of this.steps) step(pass);
        pass.end();
    }
}
