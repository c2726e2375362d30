// SPDX-License-Identifier: Apache-2.0
// drawing.js: pictures of driven Gaussians by WebGPU: splats.js, then network.js, then the bytes.
"use strict";

class RyeDrawing {
    /// For an avatar of so many Gaussians, by its network; opens a device of its own.
    static async make({ gaussians, network, software }) {
        const gpu = await RyeDevice.open(software);
        try {
            return await gpu.checked(async () => {
                const d = new RyeDrawing();
                d.gpu = gpu;
                d.splats = await RyeSplats.make(gpu, gaussians, network.channels);
                d.network = await RyeNetwork.make(gpu, network);
                return d;
            });
        } catch (fault) {
            gpu.close();
            throw fault;
        }
    }

    /// Returns the bytes of a picture, an ArrayBuffer of 4 width height. A frame is the `cloud`
    /// (RyeSplats.move), the `camera` of the render, the `rules` and the `background`
    /// (RyeSplats.look), width and height.
    draw(frame) {
        return this.#drawn(frame, [this.splats, this.network], 4 * frame.width * frame.height,
                           () => this.network.bytes);
    }

    /// Returns the render's features alone, `channels` numbers a pixel.
    async features(frame) {
        const size = 4 * this.splats.channels * frame.camera.width * frame.camera.height;
        return new Float32Array(await this.#drawn(frame, [this.splats], size, () => this.splats.render));
    }

    /// Runs the parts' steps, and returns so many bytes of a buffer of theirs.
    async #drawn(frame, parts, size, result) {
        for (;;) {
            const bytes = await this.gpu.checked(() => this.#once(frame, parts, size, result), true);
            if (bytes) return bytes;
        }
    }

    /// The same, or null where the tiles' lists had too little room: then they have enough now.
    async #once(frame, parts, size, result) {
        const { device } = this.gpu;
        this.splats.move(frame.cloud);
        this.#resize(frame, size + 4);
        this.splats.look(frame.camera, frame.rules, frame.background);
        const commands = device.createCommandEncoder();
        for (const part of parts) part.draw(commands);
        commands.copyBufferToBuffer(result(), 0, this.read, 0, size);
        commands.copyBufferToBuffer(this.splats.tally, 4 * this.splats.tiles, this.read, size, 4);
        device.queue.submit([commands.finish()]);
        await this.read.mapAsync(GPUMapMode.READ, 0, size + 4);
        const mapped = this.read.getMappedRange(0, size + 4);
        const [mentions] = new Uint32Array(mapped, size, 1), room = mentions <= this.splats.most;
        const bytes = room ? mapped.slice(0, size) : null;
        this.read.unmap();
        if (!room) this.splats.most = Math.ceil(1.25 * mentions);
        return bytes;
    }

    /// Makes the steps for a frame's sizes, and room for so many bytes on their way back.
    #resize({ camera, width, height }, bytes) {
        const renewed = this.splats.resize(camera.width, camera.height), key = `${width} ${height}`;
        if (renewed || this.key !== key)
            this.network.resize(this.splats.render, [camera.width, camera.height], [width, height]);
        this.key = key;
        if (this.read?.size >= bytes) return;
        this.read?.destroy();
        this.read = this.gpu.device.createBuffer({
            size: bytes, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
    }

    close() {
        this.gpu.close();
    }
}
