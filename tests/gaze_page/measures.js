// SPDX-License-Identifier: Apache-2.0
// measures.js: figures with bounds, and how far a canvas is from a picture.
"use strict";

/// Prints figures beside their bounds, and ends the program if one does not hold.
class Figures {
    failures = 0;
    add(what, value, holds, bound) {
        console.log(`${what.padEnd(58)} ${value.padStart(10)}   ${bound}${holds ? "" : "   FAILED"}`);
        if (!holds) ++this.failures;
    }
    end() {
        if (this.failures === 0) return;
        console.error(`${this.failures} of the bounds do not hold`);
        process.exit(1);
    }
}

/// Run in the page: [dB] between the canvas and a picture that the server has.
const psnr = (url) => `(async () => {
    const image = new Image();
    image.src = ${JSON.stringify(url)};
    await image.decode();
    const c = document.createElement("canvas");
    c.width = image.width; c.height = image.height;
    const g = c.getContext("2d");
    g.drawImage(image, 0, 0);
    const right = g.getImageData(0, 0, c.width, c.height).data;
    const p = document.getElementById("picture");
    if (p.width !== c.width || p.height !== c.height) return -1;
    const got = p.getContext("2d").getImageData(0, 0, p.width, p.height).data;
    let sum = 0, n = 0;
    for (let i = 0; i < got.length; ++i)
        if (i % 4 !== 3) { sum += (got[i] - right[i]) ** 2; ++n; }
    return 10 * Math.log10(255 * 255 / Math.max(sum / n, 1e-3));
})()`;

module.exports = { Figures, psnr };
