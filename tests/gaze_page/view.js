// SPDX-License-Identifier: Apache-2.0
// view.js CHROMIUM RYE RUN REFERENCE DRIVERS OUT: the page of `RYE view RUN` as a visitor has it. REFERENCE
// is a picture of the run by `rye redirect` at the gazes DRIVERS (left pitch, yaw, right pitch, yaw
// [degrees], with commas). Prints each figure with its bound, writes screenshots to OUT, and fails if a
// bound does not hold.
"use strict";

const { spawn } = require("node:child_process");
const dgram = require("node:dgram");
const fs = require("node:fs");
const path = require("node:path");
const { Browser } = require("../../examples/video_tracker/browser.js");
const { Figures, psnr } = require("./measures.js");

const [chromium, rye, run, reference, drivers, out] = process.argv.slice(2);
const figures = new Figures();
const figure = figures.add.bind(figures);

/// Starts the program; resolves with its address, or null where it was built without a server.
function view(words) {
    const program = spawn(rye, ["view", ...words], { stdio: ["ignore", "pipe", "pipe"] });
    let said = "", faults = "";
    program.stderr.on("data", (text) => { faults += text; });
    const ended = new Promise((resolve) => program.on("exit", (code) => resolve({ code, faults })));
    const address = new Promise((resolve) => {
        program.stdout.on("data", (text) => {
            said += text;
            const found = /^open (http\S+)$/m.exec(said);
            if (found) resolve(found[1]);
        });
        ended.then(() => resolve(null));
    });
    return { program, address, ended };
}

/// An OSC packet of floats.
function osc(address, numbers) {
    const text = (t) => Buffer.concat([Buffer.from(t), Buffer.alloc(4 - (t.length % 4))]);
    const floats = Buffer.alloc(4 * numbers.length);
    numbers.forEach((x, i) => floats.writeFloatBE(x, 4 * i));
    return Buffer.concat([text(address), text("," + "f".repeat(numbers.length)), floats]);
}

async function main() {
    if (!out) throw new Error("view.js: expected CHROMIUM RYE RUN REFERENCE DRIVERS OUT");
    fs.mkdirSync(out, { recursive: true });
    const port = 20000 + (process.pid % 20000);
    const { program, address, ended } = view([run, "--osc", String(port), "--threads", "2"]);
    const url = await address;
    if (url === null) {
        const { code, faults } = await ended;
        if (!faults.includes("built without Asio")) throw new Error(`rye view ended with ${code}: ${faults}`);
        console.log(`not run: gaze_page: the page of rye view: ${faults.trim()}`);
        return;
    }
    const b = await Browser.start(chromium, [1280, 860]);
    try {
        await b.call("Page.navigate", { url });
        await b.until("window.gazePage && gazePage.firstPicture !== null", 60000);
        await b.until("gazePage.lives", 20000);
        await b.evaluate("document.getElementById('alive').checked = false; true");
        await b.until("!gazePage.lives && !busy", 20000);
        const width = await b.evaluate("gazePage.avatar.width");
        const gaze = drivers.split(",").map((d) => (Number(d) * Math.PI) / 180);
        await b.evaluate(`gazePage.show({ gaze: ${JSON.stringify(gaze)}, expression: gazePage.avatar.expression }, ${width})`);
        const picture = `data:image/png;base64,${fs.readFileSync(reference).toString("base64")}`;
        const quality = await b.evaluate(psnr(picture));
        figure("rye view: PSNR to rye redirect, through JPEG [dB]", quality.toFixed(1), quality >= 38, "at least 38");
        await b.screenshot(path.join(out, "view.png"));

        const looks = await b.evaluate("Promise.all([[-1, 0], [1, 0]].map(gazeAt))");
        const turned = Math.min(looks[1][1] - looks[0][1], looks[1][3] - looks[0][3]);
        figure("turn of each eye from one side of the page to the other [rad]", turned.toFixed(2), turned > 0.2, "above 0.2");
        const chosen = await b.evaluate(`(async () => {
            const all = [];
            for (const id of ["accuracy", "effects"]) {
                const s = document.getElementById(id);
                s.value = s.options[s.options.length - 1].value;
                s.dispatchEvent(new Event("change"));
                await gazePage.show({});
                all.push(ryeRemote.chosen[id]);
            }
            document.getElementById("effects").value = "";
            document.getElementById("effects").dispatchEvent(new Event("change"));
            await gazePage.show({});
            return all.join(", ");
        })()`);
        figure("accuracy and effects that were chosen", chosen, chosen === "tight, still", "tight, still");
        await b.evaluate("document.getElementById('prices').click(); true");
        await b.until("document.querySelectorAll('#costs tr').length === 4", 30000);
        const costs = await b.evaluate("[...document.querySelectorAll('#costs tr:last-child td')].map((t) => t.textContent).join(' ')");
        figure("the last row of what each costs", costs, /^tight [0-9.]+ 0\.0\/255 0\.00\/255$/.test(costs), "tight, ms, 0, 0");

        // Eyes by OSC, both 20 degrees to their left, against the same gaze by hand.
        const read = `(() => { const p = document.getElementById("picture");
            return p.getContext("2d").getImageData(0, 0, p.width, p.height).data; })()`;
        await b.evaluate(`(async () => {
            const aside = 20 * Math.PI / 180;
            await gazePage.show({ gaze: [0, aside, 0, aside] });
            window.byHand = ${read};
            await gazePage.show({ gaze: [0, 0, 0, 0] });
            window.ahead = ${read};
            return true;
        })()`);
        const still = await b.evaluate("gazePage.frames");
        const socket = dgram.createSocket("udp4");
        socket.send(osc("/tracking/eye/LeftRightPitchYaw", [0, -20, 0, -20]), port, "127.0.0.1");
        await b.until(`ryeRemote.live && gazePage.frames > ${still + 5}`, 20000);
        const live = await b.evaluate(`(() => {
            const led = ${read}, most = (a) => a.reduce((m, x, i) => Math.max(m, Math.abs(x - led[i])), 0);
            return [most(byHand), most(ahead)];
        })()`);
        figure("eyes by OSC: most off the same gaze by hand, and ahead", live.join(", "),
               live[0] <= 2 && live[1] > 30, "at most 2, above 30");
        socket.close();

        figure("errors of the page and of the console", String(b.faults.length), b.faults.length === 0, "0");
        for (const fault of b.faults) console.log(`  ${fault}`);
        program.kill("SIGINT");
        const { code } = await ended;
        figure("Ctrl-C: code of the program", String(code), code === 0, "0");
        await b.until("document.getElementById('notice').textContent === 'rye view has ended'", 10000);
    } finally {
        await b.end();
        program.kill("SIGKILL");
    }
    figures.end();
}

main().catch((fault) => {
    console.error(String(fault.stack || fault));
    process.exit(1);
});
