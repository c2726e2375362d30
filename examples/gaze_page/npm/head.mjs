// SPDX-License-Identifier: Apache-2.0
// head.mjs: an avatar file drawn in a worker, for a page of one's own. head.d.ts has the types.

export class Head {
    #worker;
    #next = 1;
    #waiting = new Map(); // numbers of pictures to their promises
    #opened;

    /// Opens an avatar file by its address, or its bytes.
    static async open(avatar, options = {}) {
        if (![undefined, "wasm", "webgpu"].includes(options.draw))
            throw new RangeError(`draw: got ${options.draw}, expected "wasm" or "webgpu"`);
        const { threads } = options;
        if (threads !== undefined && !(Number.isInteger(threads) && threads >= 1))
            throw new RangeError(`threads: got ${threads}, expected a number from 1 on`);
        let bytes = avatar;
        if (typeof avatar === "string" || avatar instanceof URL) {
            const answer = await fetch(avatar);
            if (!answer.ok) throw new Error(`${avatar}: ${answer.status} ${answer.statusText}`);
            bytes = await answer.arrayBuffer();
        } else if (avatar instanceof Blob) {
            bytes = await avatar.arrayBuffer();
        }
        const head = new Head(options.worker ?? new URL("./worker.js", import.meta.url));
        try {
            head.avatar = await new Promise((resolve, reject) => {
                head.#opened = { resolve, reject };
                head.#worker.postMessage({ start: null, by: options.draw ?? "auto", threads });
                head.#worker.postMessage({ open: bytes, name: String(options.name ?? "avatar") });
            });
        } catch (fault) {
            head.close();
            throw fault;
        }
        return head;
    }

    constructor(worker) {
        this.#worker = new Worker(worker);
        this.#worker.onmessage = ({ data }) => this.#hear(data);
        this.#worker.onerror = (fault) => this.#fail(new Error(fault.message || "the worker could not start"));
    }

    /// Draws by what `parts` has; the rest is as in the picture before. Resolves with an ImageData.
    draw(parts = {}) {
        const { width, height } = this.#size(parts);
        return new Promise((resolve, reject) => {
            const id = this.#next++;
            this.#waiting.set(id, { resolve, reject });
            this.#worker.postMessage({ draw: { ...parts, width, height }, id });
        });
    }

    /// Draws and puts the picture on a canvas, whose size it gives the picture's pixels.
    async drawOn(canvas, parts = {}) {
        const drawn = await this.draw({ width: canvas.width, height: canvas.height, ...parts });
        canvas.getContext("2d", { alpha: false }).putImageData(drawn.picture, 0, 0);
        return drawn;
    }

    close() {
        this.#worker.terminate();
        this.#fail(new Error("the head is closed"));
    }

    #size({ width, height }) {
        const { width: w, height: h } = this.avatar;
        width ??= height === undefined ? w : Math.round((height * w) / h);
        height ??= Math.round((width * h) / w);
        if (!(width >= 1 && width <= 4096 && height >= 1 && height <= 4096))
            throw new RangeError(`got ${width} x ${height} pixels, expected 1 to 4096`);
        return { width, height };
    }
    #hear(data) {
        if (data.opened) return this.#opened.resolve(data.opened);
        const waits = this.#waiting.get(data.id);
        this.#waiting.delete(data.id);
        if (data.error) {
            const fault = new Error(data.error);
            return waits ? waits.reject(fault) : this.#opened.reject(fault);
        }
        const picture = new ImageData(new Uint8ClampedArray(data.picture), data.width, data.height);
        const { ms, work, by, note, threads } = data;
        waits?.resolve({ picture, ms, work, by, note, threads });
    }
    #fail(fault) {
        this.#opened?.reject(fault);
        for (const waits of this.#waiting.values()) waits.reject(fault);
        this.#waiting.clear();
    }
}
