// SPDX-License-Identifier: Apache-2.0
// evaluations.js FOLDER...: judges the pictures of evaluations (folders with results.json, per_view.json
// and evaluate_SPLIT, as `rye evaluate` writes them), writes judge.json into each that has none, and prints
// a table of the judge's numbers beside rye's. judge.sh finds the folders and sets the environment.
//
// judge.json: `not_run`, what was not measured and why; `split`, as in results.json; `all` and the groups
// that per_view.json names, each as measures.js averages it; `views`, the same of each picture.
"use strict";

const fs = require("node:fs");
const path = require("node:path");
const m = require("./measures.js");
const { dataUrl, identity, landmarker, settings, started } = require("./models.js");

function json(file) {
    try {
        return JSON.parse(fs.readFileSync(file, "utf8"));
    } catch (e) {
        throw new Error(`${file}: ${e.message.split("\n")[0]}`);
    }
}

/// Returns an evaluation's split and its pictured views, each with the picture's file.
function evaluation(folder) {
    const { split } = json(path.join(folder, "results.json")), views = json(path.join(folder, "per_view.json"));
    if (typeof split !== "string" || !Array.isArray(views))
        throw new Error(`${folder}: results.json and per_view.json are not those of rye evaluate`);
    const pictured = views.filter((v) => v.picture).map((v) =>
        ({ ...v, file: path.join(folder, `evaluate_${split}`, v.picture) }));
    for (const v of pictured) if (!fs.existsSync(v.file)) throw new Error(`${v.file}: is missing`);
    if (!pictured.length) throw new Error(`${folder}/per_view.json: names no pictures`);
    return { folder, split, views: pictured };
}

/// Returns what a model sees on the first `count` parts of pictures, by file.
async function seen(model, count, views) {
    const all = {};
    for (const v of views) all[v.file] = await model.faces(`parts("${dataUrl(v.file)}", ${count})`);
    return all;
}

/// Returns the distance of two identities; null without a face on the photograph.
function identityDistance([a, b]) {
    if (!a) return null;
    return b ? Math.hypot(...a.map((x, i) => x - b[i])) : m.missed.identity;
}

/// Returns judge.json of an evaluation.
function judged({ split, views }, faces, identities, not_run) {
    const all = views.map((v) => ({
        frame: v.frame, camera: v.camera, picture: v.picture, groups: v.groups ?? [],
        ...m.compared(faces[v.file], identities ? identityDistance(identities[v.file]) : undefined) }));
    const out = { not_run, split, all: m.averaged(all) };
    for (const group of new Set(all.flatMap((v) => v.groups)))
        out[group] = m.averaged(all.filter((v) => v.groups.includes(group)));
    return { ...out, views: all };
}

/// Returns rye's gaze error on the same pictures, and that with the gaze at rest.
function own(views, judgement) {
    const errors = ["render", "at_rest"].map((kind) => {
        const at = views.filter((v, i) => judgement.views[i].gaze?.length && v.eyes_visible > 0);
        const eyes = at.reduce((s, v) => s + v.eyes_visible, 0);
        return eyes ? at.reduce((s, v) => s + v.eyes_visible * v.gaze[kind].degrees, 0) / eyes : null;
    });
    return { degrees: errors[0], at_rest: errors[1] };
}

const shown = (x, digits, unit = "") => (x === null || x === undefined ? "-" : x.toFixed(digits) + unit);

function printed(judgements) {
    const titles = ["evaluation", "faces: photograph, render", "landmarks [% of the eyes' distance]",
                    "irises [% of an eye's width]", "gaze by irises, eyes", "rye's gaze error, same pictures",
                    "gaze by irises, eyes at rest", "rye's", "gaze by irises, photograph moved by 3 pixels",
                    "eyeBlink", "52 coefficients", "identity"];
    console.log(`\n| ${titles.join(" | ")} |\n|${"---|".repeat(titles.length)}`);
    const pairs = [];
    judgements.forEach(([{ folder, views }, found]) => {
        const { all, views: each } = found, rye = own(views, found);
        const cells = [
            folder, `${all.faces.photograph}, ${all.faces.render} of ${all.pictures}`, shown(all.landmarks, 2),
            shown(all.irises, 2), `${shown(all.gaze.degrees, 2, "°")}, ${all.gaze.eyes}`, shown(rye.degrees, 2, "°"),
            shown(all.gaze.at_rest, 2, "°"), shown(rye.at_rest, 2, "°"),
            shown(all.gaze.moved, 2, "°"), shown(all.blink, 3),
            shown(all.coefficients, 3), shown(all.identity, 3)];
        console.log(`| ${cells.join(" | ")} |`);
        each.forEach((v, k) => {
            if (v.gaze?.length && views[k].eyes_visible > 0)
                pairs.push([m.mean(v.gaze), views[k].gaze.render.degrees, views[k].file]);
        });
    });
    const missed = Object.entries(m.missed).map(([name, x]) => `${x} (${name})`).join(", ");
    console.log("\nMeans of render against photograph; equal pictures have 0 in each. A face that is found on the "
        + `photograph alone counts ${missed}. Irises and gaze: of eyes with eyeBlink below ${m.open}, gaze with the `
        + `camera less than ${m.cone}° beside the face's axis.`);
    if (!pairs.length) return;
    console.log(`Gaze by irises against rye's gaze error, over ${pairs.length} pictures: correlation `
        + `${shown(m.correlation(pairs), 2)}. They differ most on`);
    pairs.sort((a, b) => Math.abs(b[0] - b[1]) - Math.abs(a[0] - a[1]));
    for (const [judge, rye, file] of pairs.slice(0, 5))
        console.log(`  ${file}: ${judge.toFixed(1)}° by irises, ${rye.toFixed(1)}° by rye`);
}

/// Returns judge.json of an evaluation, which is written if there is none, or one that lacks what runs now;
/// null if there is none and no faces are found.
async function judgement(e, { faces, identities }, not_run) {
    const file = path.join(e.folder, "judge.json");
    if (fs.existsSync(file)) {
        const old = json(file);
        if (!faces || old.not_run?.every((line) => not_run.includes(line))) return old;
    }
    if (!faces) return null;
    const looked = [await seen(faces, 4, e.views), identities && (await seen(identities, 2, e.views))];
    const text = JSON.stringify(judged(e, ...looked, not_run), null, 1);
    fs.writeFileSync(`${file}.tmp`, `${text}\n`);
    fs.renameSync(`${file}.tmp`, file);
    return JSON.parse(text);
}

async function main() {
    const evaluations = process.argv.slice(2).map(evaluation), models = {}, done = [];
    const not_run = ["FID: no free model of its features is on npm"];
    try {
        for (const [name, model, what] of [["faces", landmarker, "landmarks, irises, gaze, coefficients"],
                                           ["identities", identity, "identity"]])
            try {
                models[name] = await started(model, settings());
            } catch (e) {
                not_run.push(`${what}: ${String(e.message).split("\n")[0]}`);
            }
        for (const line of not_run) console.log(`not run: ${line}`);
        for (const e of evaluations) done.push([e, await judgement(e, models, not_run)]);
    } finally {
        for (const model of Object.values(models)) await model.end();
    }
    const there = done.filter(([, found]) => found);
    if (there.length) printed(there);
}

if (require.main === module)
    main().catch((e) => {
        console.error(`judge: ${e.message}`);
        process.exit(1);
    });

module.exports = { evaluation, identityDistance, judged, judgement, own };
