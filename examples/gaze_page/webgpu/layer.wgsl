// SPDX-License-Identifier: Apache-2.0
// layer.wgsl: what the steps of the network share. Images are row by row, the channels of a pixel
// adjacent, `stride` numbers from one pixel to the next.

struct Layer {
    width: u32,                // of the input [px]
    height: u32,
    inputs: u32,               // channels that are read
    stride: u32,               // of the input
    outputs: u32,              // of a convolution, in fours; else the stride of the output
    rectified: u32,            // 1: the input is max(0, x)
    cut_width: u32,            // of the picture [px]
    cut_height: u32,
}

fn rectify(x: f32, on: u32) -> f32 {
    return select(x, max(x, 0.0), on == 1u);
}
