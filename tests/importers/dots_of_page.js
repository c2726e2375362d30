// SPDX-License-Identifier: Apache-2.0
// dots_of_page.js PAGE COUNT SECONDS: prints the file that PAGE, docs/gaze_dots.html, would save of so many
// dots, each shown so long to the tick, on a screen of 310 x 194 mm with the camera 8 mm above it.
"use strict";

const fs = require("node:fs");

const [page, count, seconds] = process.argv.slice(2);
const script = fs.readFileSync(page, "utf8").match(/<script>([\s\S]*)<\/script>/)[1];
const { places, csv } = new Function(`${script}; return { places, csv };`)();
const shown = places(Number(count)).map((place, i) => [i * seconds, (i + 1) * seconds - 0.01, place]);
process.stdout.write(csv(shown, { width: 310, height: 194, right: 0, above: 8 }));
