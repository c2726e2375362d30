// SPDX-License-Identifier: Apache-2.0
// camera.js: an orbit about a point: rows of camera_from_world (OpenCV: x right, y down, z forward)
// from the start camera, turned about the head and moved along its line of sight.
"use strict";

const Orbit = (() => {
    const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                             a[0] * b[1] - a[1] * b[0]];
    const scaled = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
    const unit = (a) => scaled(a, 1 / Math.hypot(...a));
    /// a turned about the unit axis.
    const turned = (a, axis, angle) => {
        const c = Math.cos(angle), s = Math.sin(angle), along = dot(a, axis) * (1 - c);
        const side = cross(axis, a);
        return [0, 1, 2].map((i) => c * a[i] + s * side[i] + along * axis[i]);
    };

    class Orbit {
        /// motion: 16 numbers, rows of camera_from_world; target: the point it turns about.
        constructor(motion, target) {
            const rows = [0, 1, 2].map((i) => Array.from(motion.slice(4 * i, 4 * i + 3)));
            const t = [motion[3], motion[7], motion[11]];
            const eye = [0, 1, 2].map((k) => -(rows[0][k] * t[0] + rows[1][k] * t[1] + rows[2][k] * t[2]));
            this.start = { rows, motion: Array.from(motion), arm: sub(eye, target) };
            this.target = target;
            this.reset();
        }
        reset() {
            this.yaw = 0;
            this.pitch = 0;
            this.zoom = 1;
        }
        turn(yaw, pitch) {
            this.yaw = Math.max(-1.2, Math.min(1.2, this.yaw + yaw));
            this.pitch = Math.max(-0.7, Math.min(0.7, this.pitch + pitch));
        }
        magnify(factor) {
            this.zoom = Math.max(0.6, Math.min(2.5, this.zoom * factor));
        }
        get moved() {
            return this.yaw !== 0 || this.pitch !== 0 || this.zoom !== 1;
        }
        /// At rest the very numbers of the file, so that its picture is the file's.
        motion() {
            if (!this.moved) return this.start.motion;
            const up = scaled(this.start.rows[1], -1), right = this.start.rows[0];
            const turn = (v) => turned(turned(v, right, -this.pitch), up, -this.yaw);
            const rows = this.start.rows.map((r) => unit(turn(r)));
            const arm = scaled(turn(this.start.arm), 1 / this.zoom);
            const eye = [0, 1, 2].map((k) => this.target[k] + arm[k]);
            const motion = [];
            for (const r of rows) motion.push(...r, -dot(r, eye));
            return [...motion, 0, 0, 0, 1];
        }
        /// Axes of the camera in the world: right, up, toward the viewer.
        axes() {
            const m = this.motion();
            return [[m[0], m[1], m[2]], [-m[4], -m[5], -m[6]], [-m[8], -m[9], -m[10]]];
        }
    }
    return Orbit;
})();

if (typeof module !== "undefined") module.exports = Orbit;
