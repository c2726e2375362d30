// SPDX-License-Identifier: Apache-2.0
// device.js: a WebGPU device, and rye's steps on it. Whatever it lacks is an Error with a sentence;
// the worker then draws by WebAssembly. build.sh puts the texts of the .wgsl files before this, as
// ryeShaders.
"use strict";

class RyeDevice {
    /// Opens a device, of software only if that is wanted: WebAssembly is faster than one.
    static async open(software) {
        if (!navigator.gpu) throw new Error("this browser has no WebGPU");
        const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
        if (!adapter) throw new Error("WebGPU has no adapter here");
        const { info, limits } = adapter;
        if (!software && (info?.isFallbackAdapter || info?.architecture === "swiftshader"))
            throw new Error("WebGPU has an adapter of software alone");
        const requiredLimits = {};
        for (const name of ["maxBufferSize", "maxStorageBufferBindingSize"])
            requiredLimits[name] = limits[name];
        const device = await adapter.requestDevice({ requiredLimits });
        return new RyeDevice(device, [info?.vendor, info?.architecture].filter(Boolean).join(" "));
    }

    constructor(device, name) {
        this.device = device;
        this.name = name;
        this.fault = null;     ///< why nothing more can be drawn
        device.lost.then(({ message, reason }) => {
            this.fault ??= `the WebGPU device was lost (${message || reason})`;
        });
        device.addEventListener("uncapturederror", ({ error }) => { this.fault ??= error.message; });
    }

    /// Returns the pipeline of an entry point of the files `names`, one text after constants.
    async pipeline(names, entryPoint, constants = {}) {
        const numbers = Object.entries(constants).map(([name, n]) => `const ${name} = ${n}u;\n`);
        const code = [...numbers, ...names.map((name) => ryeShaders[name])].join("");
        const module = this.device.createShaderModule({ code, label: names.at(-1) });
        const { messages } = await module.getCompilationInfo();
        const wrong = messages.find(({ type }) => type === "error");
        if (wrong) throw new Error(`${names.at(-1)}.wgsl: ${wrong.message}`);
        return this.device.createComputePipelineAsync({
            layout: "auto", label: entryPoint, compute: { module, entryPoint } });
    }

    /// Returns a buffer of at least so many bytes that steps read and write.
    storage(bytes, more = 0) {
        const { maxBufferSize, maxStorageBufferBindingSize } = this.device.limits;
        const size = Math.max(16, 4 * Math.ceil(bytes / 4));
        const most = Math.min(maxBufferSize, maxStorageBufferBindingSize);
        if (size > most)
            throw new Error(`a buffer would take ${size} bytes, more than the ${most} that WebGPU gives here`);
        return this.device.createBuffer({
            size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_DST | more });
    }
    /// Returns a buffer that holds an array.
    holding(array, usage = GPUBufferUsage.STORAGE) {
        const size = Math.max(16, array.byteLength);
        const buffer = this.device.createBuffer({ size, usage: usage | GPUBufferUsage.COPY_DST });
        this.device.queue.writeBuffer(buffer, 0, array);
        return buffer;
    }
    /// Returns a function that adds a step to a pass: a pipeline on buffers, for so many workgroups.
    /// null stands for a binding that the step does not use.
    step(pipeline, buffers, groups) {
        const entries = buffers.map((buffer, binding) => ({ binding, resource: { buffer } }))
            .filter(({ resource }) => resource.buffer);
        const bound = this.device.createBindGroup({ layout: pipeline.getBindGroupLayout(0), entries });
        return (pass) => {
            pass.setPipeline(pipeline);
            pass.setBindGroup(0, bound);
            pass.dispatchWorkgroups(...groups);
        };
    }

    /// f(), whose faults of WebGPU are errors; those that come before it first waits, if it is
    /// `atOnce`: then the device answers while f waits.
    async checked(f, atOnce = false) {
        const kinds = ["validation", "out-of-memory", "internal"];
        for (const kind of kinds) this.device.pushErrorScope(kind);
        const done = f().then((result) => ({ result, thrown: null }), (thrown) => ({ thrown }));
        if (!atOnce) await done;
        const errors = kinds.map(() => this.device.popErrorScope().catch(() => null));
        const { result, thrown } = await done;
        for (const error of await Promise.all(errors))
            if (error) this.fault ??= error.message;
        if (thrown && !(thrown instanceof DOMException)) throw thrown;  // it says more
        if (this.fault) throw new Error(this.fault);
        if (thrown) throw thrown;
        return result;
    }

    close() {
        this.device.destroy();
    }
}
