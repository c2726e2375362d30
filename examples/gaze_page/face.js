// SPDX-License-Identifier: Apache-2.0
// face.js: what a face that MediaPipe's Face Landmarker has found means to an avatar: where the visitor
// is, coefficients by their names, gazes. As driving/retarget.cpp of the trainer has it.
"use strict";

const Face = (() => {
    const halfField = (63 / 2) * (Math.PI / 180);  // MediaPipe's own: of the camera, down the picture
    const aside = (40 * Math.PI) / 180, upward = (30 * Math.PI) / 180;  // of a look of 1
    const irises = [468, 473], forward = 14;       // landmarks; place in the matrix, column by column

    /// Name without its side, in any spelling: of browDown_L and BrowDownLeft "browdown" and "l".
    function sided(name) {
        const plain = name.toLowerCase().replace(/[^a-z0-9]/g, "");
        for (const [end, side] of [["left", "l"], ["right", "r"]])
            if (plain.length > end.length && plain.endsWith(end))
                return { base: plain.slice(0, -end.length), side };
        const mark = /[_.\- ]([lr])$/i.exec(name);
        return mark ? { base: plain.slice(0, -1), side: mark[1].toLowerCase() } : { base: plain, side: "" };
    }

    /// For each of an avatar's names the tracked coefficients it takes, [place, weight]: that of its
    /// name; one with a side, else, that without; one without, else, the mean of both sides.
    function sources(tracked, names) {
        const all = tracked.map(sided);
        const at = (base, side) => all.findIndex((n) => n.base === base && n.side === side);
        return names.map((name) => {
            if (name === "") return [];
            const { base, side } = sided(name), own = at(base, side);
            if (own >= 0) return [[own, 1]];
            if (side !== "") return at(base, "") >= 0 ? [[at(base, ""), 1]] : [];
            const both = [at(base, "l"), at(base, "r")];
            return both.every((i) => i >= 0) ? both.map((i) => [i, 0.5]) : [];
        });
    }

    /// The avatar's expression: what is not driven is as in `rest`; within the ranges of training.
    function expression(from, scores, { low, high }, rest) {
        return rest.map((x, k) => {
            const list = from[k] ?? [];
            if (list.length === 0) return x;
            const sum = list.reduce((s, [i, weight]) => s + weight * scores[i], 0);
            return Math.min(high[k], Math.max(low[k], sum));
        });
    }

    /// Pitch and yaw of the left, then of the right eye [rad], from the coefficients of looking; null
    /// without them.
    function gaze(tracked, scores) {
        const score = (name) => scores[tracked.indexOf(name)];
        const eyes = [["Left", "Out", "In"], ["Right", "In", "Out"]];
        const angles = eyes.flatMap(([eye, toLeft, toRight]) => [
            upward * (score(`eyeLookUp${eye}`) - score(`eyeLookDown${eye}`)),
            aside * (score(`eyeLook${toLeft}${eye}`) - score(`eyeLook${toRight}${eye}`))]);
        return angles.every(Number.isFinite) ? angles : null;
    }

    /// The point between the visitor's eyes as the camera sees it [cm]: to its right, up, before it.
    function place(landmarks, matrix, width, height) {
        const distance = -matrix[forward], focal = height / (2 * Math.tan(halfField));  // [cm], [px]
        const [x, y] = ["x", "y"].map((k) => (landmarks[irises[0]][k] + landmarks[irises[1]][k]) / 2);
        return [((x - 0.5) * width * distance) / focal, ((0.5 - y) * height * distance) / focal, distance];
    }

    return { sided, sources, expression, gaze, place, halfField };
})();

if (typeof module !== "undefined") module.exports = Face;
