// SPDX-License-Identifier: Apache-2.0
/** What an avatar file holds. Angles are radians; eyes: the subject's left one first. */
export interface Avatar {
    readonly name: string;
    readonly gaussians: number;
    /** Numbers of a Gaussian's feature, and of the background. */
    readonly channels: number;
    /** Names of the coefficients of its expression, empty strings where they have none. */
    readonly names: readonly string[];
    /** Its first expression, and the range of each coefficient in training. */
    readonly expression: readonly number[];
    readonly low: readonly number[];
    readonly high: readonly number[];
    /** Pitch and yaw of the left, then of the right eye; up and the subject's left are +. */
    readonly gaze: readonly number[];
    readonly gazeLow: readonly number[];
    readonly gazeHigh: readonly number[];
    /** Axis-angle and translation of the head; world units per unit of the head. */
    readonly pose: readonly number[];
    readonly scale: number;
    /** Centres of the eyeballs in the head; middle and radius of the head in the world. */
    readonly eyes: readonly number[];
    readonly head: readonly number[];
    readonly radius: number;
    /** Rows of camera_from_world (x right, y down, z forward), 16 numbers; fx, fy, cx, cy. */
    readonly motion: readonly number[];
    readonly lens: readonly number[];
    readonly width: number;
    readonly height: number;
}

/** What moves a head; what is left out stays as in the picture before. */
export interface Parts {
    gaze?: readonly number[];
    /** A point of the world that both eyes look at, instead of `gaze`. */
    lookAt?: readonly [number, number, number];
    expression?: readonly number[];
    pose?: readonly number[];
    motion?: readonly number[];
    /** What is behind the head, `channels` numbers; first that of training. */
    background?: readonly number[];
    /** Seconds, 0 to 3600, that the eyes have glanced and blinked by themselves; in this picture alone. */
    idle?: number;
    /** Pixels; without them those of the avatar's camera. */
    width?: number;
    height?: number;
}

export interface Drawn {
    readonly picture: ImageData;
    /** Time that drawing took. */
    readonly ms: number;
    /** Gaussians that moved, tiles and pixels that were computed. */
    readonly work: { readonly gaussians: number; readonly tiles: number; readonly pixels: number };
    /** What drew it, and, if not WebGPU though that was tried, why. */
    readonly by: "wasm" | "webgpu";
    readonly note: string;
    /** Threads of WebAssembly; one unless the page is cross-origin isolated. */
    readonly threads: number;
}

export class Head {
    /** Opens an avatar file by its address, or its bytes; rejects with a sentence for a damaged one.
     *  `draw`: without it pictures are WebGPU's once that is ready, where it is hardware, and
     *  WebAssembly's otherwise; "wasm" is never WebGPU, "webgpu" is so on software too, from the first
     *  picture on. Where WebGPU fails WebAssembly goes on, and `note` of a picture says why. In a page
     *  that is cross-origin isolated WebAssembly has a thread for each processor, up to 8, or `threads`. */
    static open(
        avatar: string | URL | ArrayBuffer | Blob,
        options?: { worker?: string | URL; name?: string; draw?: "wasm" | "webgpu"; threads?: number },
    ): Promise<Head>;
    readonly avatar: Avatar;
    draw(parts?: Parts): Promise<Drawn>;
    drawOn(canvas: HTMLCanvasElement, parts?: Parts): Promise<Drawn>;
    close(): void;
}
