// SPDX-License-Identifier: Apache-2.0
// network.js: the upsampler after a render (rye/nn/upsampler.hpp; rye_upsampler of rye/c/rye.h) as
// steps of WebGPU, from features to bytes: convolve, normalize, double and picture.wgsl.
"use strict";

class RyeNetwork {
    /// For { channels, capacity, doublings, normalized, skip, convolution, outWeight, outBias }.
    static async make(gpu, shape) {
        const n = new RyeNetwork();
        Object.assign(n, { gpu, shape, made: [] });
        n.pipelines = {};
        for (const [file, entry] of [["convolve", "convolve"], ["double", "enlarge"],
                                     ["normalize", "normalize_channel"], ["picture", "finish"]])
            n.pipelines[file] = await gpu.pipeline(["layer", file], entry);
        n.weights = shape.convolution.map((w, l) => gpu.holding(inFours(w, n.outputs(l))));
        n.last = gpu.holding(Float32Array.of(...shape.outWeight, ...shape.outBias));
        return n;
    }

    /// Outputs of layer l.
    outputs(l) {
        return this.shape.capacity << (this.shape.doublings - (l >> 1));
    }

    /// Makes the steps for a render [px] and a picture cut to [px].
    resize(render, [width, height], [cutWidth, cutHeight]) {
        const { gpu, shape, pipelines } = this;
        for (const b of this.made) b.destroy();
        this.made = [];
        this.steps = [];
        const keep = (buffer) => {
            this.made.push(buffer);
            return buffer;
        };
        const layer = (...numbers) =>
            keep(gpu.holding(Uint32Array.of(...numbers, cutWidth, cutHeight), GPUBufferUsage.UNIFORM));
        const squares = (w, h) => [Math.ceil(w / 8), Math.ceil(h / 8)];
        /// An image { buffer, width, height, channels, stride, rectified }, enlarged.
        const doubled = (image) => {
            const w = 2 * image.width, h = 2 * image.height, { channels } = image;
            const buffer = keep(gpu.storage(4 * w * h * channels));
            const numbers = layer(image.width, image.height, channels, image.stride, channels, image.rectified);
            this.steps.push(gpu.step(pipelines.double, [numbers, image.buffer, buffer], squares(w, h)));
            return { buffer, width: w, height: h, channels, stride: channels, rectified: 0 };
        };
        const { channels } = shape;
        const given = { buffer: render, width, height, channels, stride: channels, rectified: 0 };
        let image = given;
        for (let l = 0; l < 2 * (shape.doublings + 1); ++l) {
            if (l > 0 && l % 2 === 0) image = doubled(image);
            const fours = Math.ceil(this.outputs(l) / 4), { width: w, height: h } = image;
            const buffer = keep(gpu.storage(16 * w * h * fours));
            const numbers = layer(w, h, image.channels, image.stride, fours, image.rectified);
            this.steps.push(gpu.step(pipelines.convolve, [numbers, image.buffer, this.weights[l], buffer],
                                     [...squares(w, h), fours]));
            image = { buffer, width: w, height: h, channels: this.outputs(l), stride: 4 * fours, rectified: 1 };
            if (shape.normalized)
                this.steps.push(gpu.step(pipelines.normalize,
                    [layer(w, h, image.channels, image.stride, 0, 0), buffer], [image.channels]));
        }
        let base = { ...given, channels: 3 };
        if (shape.skip) for (let d = 0; d < shape.doublings; ++d) base = doubled(base);
        this.bytes = keep(gpu.storage(4 * cutWidth * cutHeight, GPUBufferUsage.COPY_SRC));
        const numbers = layer(image.width, image.height, image.channels, image.stride,
                              shape.skip ? base.stride : 0, 1);
        this.steps.push(gpu.step(pipelines.picture, [numbers, image.buffer, this.last, base.buffer, this.bytes],
                                 squares(cutWidth, cutHeight)));
    }

    /// Adds a picture to the commands.
    draw(commands) {
        const pass = commands.beginComputePass();
        for (const step of this.steps) step(pass);
        pass.end();
    }
}

/// Weights whose rows of outputs are filled with zeros up to a multiple of four.
function inFours(weights, outputs) {
    const fours = 4 * Math.ceil(outputs / 4), rows = weights.length / outputs;
    const filled = new Float32Array(rows * fours);
    for (let r = 0; r < rows; ++r)
        filled.set(weights.subarray(r * outputs, (r + 1) * outputs), r * fours);
    return filled;
}
