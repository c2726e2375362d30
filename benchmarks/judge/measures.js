// SPDX-License-Identifier: Apache-2.0
// measures.js: what the judge's faces say of two pictures of one view, and how it is averaged; no
// browser. A face is what models.js returns for a picture, null if none was found:
//   landmarks      478 x [x, y], pixels
//   coefficients   {"eyeBlinkLeft": 0.1, ...}, 52 of them, 0 to 1
//   matrix         16 numbers, column by column: the face's frame (x the subject's left, y up, z out
//                  of the face) to the camera's (x right, y up, z towards the viewer)
// Angles are in degrees, + towards the subject's left and up.
"use strict";

/// What a face counts that is found on the photograph and not on the other picture.
const missed = { landmarks: 100, irises: 50, gaze: 90, blink: 1, coefficients: 1, identity: 1 };
/// An eye counts whose eyeBlink is below this on the photograph.
const open = 0.4;
/// A gaze counts if the camera is less than this beside the photographed face's z axis [degrees].
const cone = 20;

/// The left eye and the right one: corners and the iris' middle, and +1 where the temple is at +x.
const eyes = [
    { name: "Left", inner: 362, outer: 263, iris: 473, sign: 1 },
    { name: "Right", inner: 133, outer: 33, iris: 468, sign: -1 },
];
/// An iris' offset, horizontally (+ towards the temple) and vertically, is the sum of these, times 1, the
/// gaze's yaw and pitch, and the camera's, yaws towards the temple; of capture A's training frames, as
/// photographs.js prints them.
const irisCalibration = [[0.02103, 0.05033], [0.00701, -0.00038], [0.00044, 0.00261],
                         [-0.00284, 0.00012], [0.00007, -0.00145]];

const degrees = 180 / Math.PI;
const mean = (numbers) => (numbers.length ? numbers.reduce((s, x) => s + x, 0) / numbers.length : null);
const apart = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);
const middle = (p, q) => [(p[0] + q[0]) / 2, (p[1] + q[1]) / 2];
const corners = (face, eye) => [face.landmarks[eye.inner], face.landmarks[eye.outer]];

/// Returns where the iris is, from the middle of the eye's corners, along them towards the temple and
/// up, in widths of the eye.
function irisOffset(face, eye) {
    const [inner, outer] = corners(face, eye), m = middle(inner, outer), p = face.landmarks[eye.iris];
    const u = [outer[0] - inner[0], outer[1] - inner[1]], n = u[0] * u[0] + u[1] * u[1];
    const d = [p[0] - m[0], p[1] - m[1]];
    return [(d[0] * u[0] + d[1] * u[1]) / n, (eye.sign * (d[0] * u[1] - d[1] * u[0])) / n];
}
/// Returns the same by the coefficients: outwards less inwards, up less down.
function lookOffset(face, eye) {
    const c = (name) => face.coefficients[`eyeLook${name}${eye.name}`];
    return [c("Out") - c("In"), c("Up") - c("Down")];
}
/// Returns yaw and pitch of the direction from the face to the camera.
function cameraAngles(face) {
    const [x, y, z] = [2, 6, 10].map((k) => face.matrix[k]);
    return [degrees * Math.atan2(x, z), degrees * Math.atan2(y, Math.hypot(x, z))];
}
/// Returns the angle between the camera and the face's z axis.
function offAxis([yaw, pitch]) {
    return degrees * Math.acos(Math.cos(yaw / degrees) * Math.cos(pitch / degrees));
}
/// Returns yaw and pitch of an eye's gaze in the head, of its offset and the camera's angles.
function gazeOf(offset, eye, camera, calibration) {
    const [one, yaw, pitch, cameraYaw, cameraPitch] = calibration;
    const [x, y] = [0, 1].map((k) =>
        offset[k] - one[k] - cameraYaw[k] * eye.sign * camera[0] - cameraPitch[k] * camera[1]);
    const d = yaw[0] * pitch[1] - yaw[1] * pitch[0];
    return [(eye.sign * (x * pitch[1] - y * pitch[0])) / d, (y * yaw[0] - x * yaw[1]) / d];
}
/// Returns the angle between two directions of such yaw and pitch.
function angle(a, b) {
    const v = ([yaw, pitch]) => [Math.sin(yaw / degrees) * Math.cos(pitch / degrees), Math.sin(pitch / degrees),
                                 Math.cos(yaw / degrees) * Math.cos(pitch / degrees)];
    const p = v(a), q = v(b), dot = p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
    const cross = Math.hypot(p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2],
                             p[0] * q[1] - p[1] * q[0]);
    return degrees * Math.atan2(cross, dot);
}

/// Returns the calibration that explains eyes best, each with offset [2], gaze [yaw, pitch], camera and
/// eye; throws an Error with fewer than ten.
function calibrated(samples) {
    if (samples.length < 10) throw new Error(`${samples.length} open eyes to calibrate by, expected 10 or more`);
    const columns = [0, 1].map((k) => leastSquares(samples.map((s) =>
        [[1, s.eye.sign * s.gaze[0], s.gaze[1], s.eye.sign * s.camera[0], s.camera[1]], s.offset[k]])));
    return columns[0].map((x, i) => [x, columns[1][i]]);
}
/// Returns the numbers c with the least sum of (row . c - value)^2.
function leastSquares(equations) {
    const n = equations[0][0].length, a = Array.from({ length: n }, () => new Array(n + 1).fill(0));
    for (const [row, value] of equations)
        for (let i = 0; i < n; ++i) {
            for (let j = 0; j < n; ++j) a[i][j] += row[i] * row[j];
            a[i][n] += row[i] * value;
        }
    for (let i = 0; i < n; ++i) {
        for (let k = i; k < n; ++k) if (Math.abs(a[k][i]) > Math.abs(a[i][i])) [a[i], a[k]] = [a[k], a[i]];
        for (let k = 0; k < n; ++k) {
            if (k === i) continue;
            const f = a[k][i] / a[i][i];
            for (let j = i; j <= n; ++j) a[k][j] -= f * a[i][j];
        }
    }
    return a.map((row, i) => row[n] / row[i]);
}

/// Returns the eyes of a photograph that count, and those whose gaze does.
function counted(photograph) {
    const seen = eyes.filter((e) => photograph.coefficients[`eyeBlink${e.name}`] < open);
    return { seen, gazes: offAxis(cameraAngles(photograph)) < cone ? seen : [] };
}
/// Returns the angles between the gazes of the counted eyes on a photograph and on another picture; the
/// head is where the photograph shows it.
function gazeErrors(photograph, other) {
    const camera = cameraAngles(photograph);
    return counted(photograph).gazes.map((e) => {
        if (!other) return missed.gaze;
        const of = (face) => gazeOf(irisOffset(face, e), e, camera, irisCalibration);
        return angle(of(photograph), of(other));
    });
}

/// Returns what distinguishes the faces of a photograph, a render, and a render with the gaze at rest; a
/// number is null and a list empty where the photograph has no such thing. `moved`, if given, is the face of
/// the same photograph moved by a few pixels: what differs there is the judge's own scatter. `identity` is
/// the distance of identities on photograph and render: null without a face on the photograph, undefined if
/// not run.
function compared([photograph, render, rest, moved], identity) {
    const view = { found: [!!photograph, !!render] };
    if (photograph) {
        const { seen } = counted(photograph), p = photograph, q = render;
        const width = apart(middle(...corners(p, eyes[0])), middle(...corners(p, eyes[1])));
        const blink = (face, e) => face.coefficients[`eyeBlink${e.name}`];
        const of = (name, f) => (q ? f() : missed[name]);
        view.landmarks = of("landmarks", () =>
            (100 * mean(p.landmarks.map((x, i) => apart(x, q.landmarks[i])))) / width);
        view.irises = seen.map((e) => of("irises", () => 100 * apart(irisOffset(p, e), irisOffset(q, e))));
        view.gaze = gazeErrors(p, q);
        view.gaze_at_rest = gazeErrors(p, rest);
        if (moved !== undefined) view.gaze_moved = gazeErrors(p, moved);
        view.blink = of("blink", () => mean(eyes.map((e) => Math.abs(blink(p, e) - blink(q, e)))));
        view.coefficients = of("coefficients", () =>
            mean(Object.entries(p.coefficients).map(([name, x]) => Math.abs(x - q.coefficients[name]))));
    }
    if (identity !== undefined) view.identity = identity;
    return view;
}

/// Returns the means over views as `compared` returns them: over photographs with a face, or over eyes.
function averaged(views) {
    const seen = (name) => views.map((v) => v[name]).filter((x) => x !== undefined && x !== null);
    const of = (name) => mean(seen(name).flat());
    return {
        pictures: views.length,
        faces: { photograph: views.filter((v) => v.found[0]).length,
                 render: views.filter((v) => v.found[1]).length },
        landmarks: of("landmarks"), irises: of("irises"),
        gaze: { degrees: of("gaze"), at_rest: of("gaze_at_rest"), moved: of("gaze_moved"),
                eyes: seen("gaze").flat().length },
        blink: of("blink"), coefficients: of("coefficients"), identity: of("identity"),
    };
}

/// Returns the correlation of pairs of numbers; null of fewer than three.
function correlation(pairs) {
    if (pairs.length < 3) return null;
    const a = mean(pairs.map((p) => p[0])), b = mean(pairs.map((p) => p[1]));
    let ab = 0, aa = 0, bb = 0;
    for (const [x, y] of pairs) ab += (x - a) * (y - b), aa += (x - a) ** 2, bb += (y - b) ** 2;
    return aa > 0 && bb > 0 ? ab / Math.sqrt(aa * bb) : null;
}

module.exports = { angle, averaged, calibrated, cameraAngles, compared, cone, correlation, eyes, gazeOf,
                   irisCalibration, irisOffset, lookOffset, mean, missed, offAxis, open };
