// SPDX-License-Identifier: Apache-2.0
// browser.js: a headless Chromium, driven over its DevTools protocol through two pipes, so that no
// WebSocket and no package is needed (node 18 has neither), and a static file server for a folder.
"use strict";

const { spawn } = require("node:child_process");
const fs = require("node:fs");
const http = require("node:http");
const os = require("node:os");
const path = require("node:path");

const kinds = { ".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".mjs": "text/javascript",
                ".wasm": "application/wasm", ".png": "image/png", ".jpg": "image/jpeg",
                ".svg": "image/svg+xml" };

/// Serves the files of folders, the first that has one; nothing else. `headers`: further ones of each.
function serve(folders, headers = {}) {
    const server = http.createServer((request, answer) => {
        const name = decodeURIComponent(new URL(request.url, "http://x").pathname).replace(/\/$/, "/index.html");
        const file = folders.map((folder) => path.join(folder, path.normalize(name)))
            .find((f) => fs.existsSync(f) && fs.statSync(f).isFile());
        if (!file) {
            answer.writeHead(404).end();
            return;
        }
        answer.writeHead(200, { "Content-Type": kinds[path.extname(file)] || "application/octet-stream", ...headers });
        fs.createReadStream(file).pipe(answer);
    });
    return new Promise((resolve) => server.listen(0, "127.0.0.1", () => resolve(server)));
}

class Browser {
    /// `more`: further options of Chromium.
    static async start(program, size, more = []) {
        const b = new Browser();
        b.profile = fs.mkdtempSync(path.join(os.tmpdir(), "rye-chromium-"));
        b.process = spawn(program, ["--headless=new", "--no-sandbox",
            ...(more.includes("--enable-gpu") ? [] : ["--disable-gpu"]), "--disable-dev-shm-usage", "--no-first-run", "--disable-extensions", "--hide-scrollbars",
            "--force-color-profile=srgb", "--force-device-scale-factor=1",
            "--disable-background-networking", "--disable-component-update",
            `--window-size=${size[0]},${size[1]}`,
            ...more, "--remote-debugging-pipe", `--user-data-dir=${b.profile}`, "about:blank"],
            { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
        b.waiting = new Map();
        b.next = 1;
        b.faults = [];  // of the console, of scripts, of the network
        b.workers = []; // sessions of the page's workers, the last one's last
        b.ended = new Promise((resolve) => b.process.on("exit", resolve));
        b.ended.then(() => {
            for (const w of b.waiting.values()) w.reject(new Error("the browser ended"));
        });
        b.process.on("error", (e) => {
            for (const w of b.waiting.values()) w.reject(e);
        });
        let rest = Buffer.alloc(0);
        b.process.stdio[4].on("data", (data) => {
            rest = Buffer.concat([rest, data]);
            for (let end; (end = rest.indexOf(0)) >= 0; rest = rest.subarray(end + 1))
                b.receive(JSON.parse(rest.subarray(0, end).toString()));
        });
        const { targetId } = await b.call("Target.createTarget", { url: "about:blank" });
        b.session = (await b.call("Target.attachToTarget", { targetId, flatten: true })).sessionId;
        for (const domain of ["Page", "Runtime", "Log"]) await b.call(`${domain}.enable`);
        await b.call("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: true });
        await b.view(size[0], size[1]);
        return b;
    }
    receive(message) {
        const w = this.waiting.get(message.id);
        if (w) {
            this.waiting.delete(message.id);
            if (message.error) w.reject(new Error(`${w.method}: ${message.error.message}`));
            else w.resolve(message.result);
        }
        const p = message.params;
        if (message.method === "Target.attachedToTarget" && p.targetInfo.type === "worker")
            this.workers.push(p.sessionId);
        if (message.method === "Target.detachedFromTarget")
            this.workers = this.workers.filter((id) => id !== p.sessionId);
        if (message.method === "Runtime.exceptionThrown")
            this.faults.push(p.exceptionDetails.exception?.description || p.exceptionDetails.text);
        if (message.method === "Runtime.consoleAPICalled" && (p.type === "error" || p.type === "warning"))
            this.faults.push(p.args.map((a) => a.value ?? a.description).join(" "));
        if (message.method === "Log.entryAdded" && p.entry.level === "error")
            this.faults.push(`${p.entry.text} ${p.entry.url || ""}`);
    }
    call(method, params = {}, sessionId = this.session) {
        const id = this.next++;
        return new Promise((resolve, reject) => {
            this.waiting.set(id, { resolve, reject, method });
            this.process.stdio[3].write(
                `${JSON.stringify({ id, method, params, sessionId })}\0`);
        });
    }
    view(width, height, mobile = false) {
        return this.call("Emulation.setDeviceMetricsOverride",
                         { width, height, deviceScaleFactor: 1, mobile });
    }
    /// The value of an expression in the page, or in a worker; a promise is waited for.
    async evaluate(expression, session = this.session) {
        const { result, exceptionDetails } = await this.call("Runtime.evaluate",
            { expression, awaitPromise: true, returnByValue: true }, session);
        if (exceptionDetails)
            throw new Error(exceptionDetails.exception?.description || exceptionDetails.text);
        return result.value;
    }
    /// Until the expression is true; throws after `limit` [ms].
    async until(expression, limit) {
        for (const begin = Date.now(); Date.now() - begin < limit;) {
            if (await this.evaluate(expression)) return;
            await new Promise((resolve) => setTimeout(resolve, 10));
        }
        throw new Error(`not so within ${limit} ms: ${expression}; faults: ${this.faults.join("; ")}`);
    }
    async screenshot(file, clip) {
        const { data } = await this.call("Page.captureScreenshot",
            { format: "png", ...(clip ? { clip: { ...clip, scale: 1 } } : {}) });
        fs.writeFileSync(file, Buffer.from(data, "base64"));
    }
    async end() {
        this.process.kill("SIGKILL");
        await this.ended;
        for (let i = 0; i < 20; ++i)  // its children may still be writing
            try {
                fs.rmSync(this.profile, { recursive: true, force: true });
                return;
            } catch {
                await new Promise((resolve) => setTimeout(resolve, 50));
            }
    }
}

module.exports = { Browser, serve };
