#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""networks_torch.py PROGRAM: rye's encoding, perceptron, upsampler and Adam against PyTorch's.

Runs PROGRAM (networks.cpp), which writes inputs, weights, outputs and gradients in float64, and
computes the same with torch's layers and autograd. Exit status 77: torch is not installed.
"""
import os
import subprocess
import sys
import tempfile

sys.dont_write_bytecode = True
from tensors import read_f64, relative_error, torch  # noqa: E402

import torch.nn.functional as F  # noqa: E402

errors = {}


def leaf(t):
    return t.clone().requires_grad_(True)


def image(t, width, height):
    """(pixels, channels) as torch's (1, channels, height, width)."""
    return t.reshape(height, width, -1).permute(2, 0, 1)[None]


def check_mlp(t):
    names = [n for n in t if n.startswith("mlp.")]
    p = {n: leaf(t[n].T) for n in names}  # as out x in
    x, frame = leaf(t["x"]), leaf(t["frame"])
    code = torch.cat([x] + [f(2**k * x) for k in range(4) for f in (torch.sin, torch.cos)], 1)
    inputs = torch.cat([code, frame.expand(len(x), -1)], 1)
    h = inputs
    for layer in range(4):
        h = torch.cat([h, inputs], 1) if layer == 2 else h
        h = F.linear(h, p[f"mlp.conv{layer}.weight"], p[f"mlp.conv{layer}.bias"][:, 0])
        h = F.leaky_relu(h, 0.01) if layer < 3 else h
    h.backward(t["g_y"])
    errors["mlp"] = relative_error(t["y"], h)
    errors["mlp g_x"] = relative_error(t["g_x"], x.grad)
    errors["mlp g_frame"] = relative_error(t["g_frame"], frame.grad)
    adam = torch.optim.Adam(p.values(), lr=1e-3)
    gradients = {n: p[n].grad.clone() for n in names}
    for _ in range(3):
        adam.step()
    for n in names:
        errors["g_" + n] = relative_error(t["g_" + n].T, gradients[n])
        errors["adam_" + n] = relative_error(t["adam_" + n].T, p[n].detach())


def check_upsampler(t, name, normal, skip, width=7, height=6):
    kernel = {}
    for n in t:
        if n.startswith(name + ".") and ".double_conv." in n and ".g." not in n:
            out = t[n].shape[1]
            kernel[n] = leaf(t[n].reshape(3, 3, -1, out).permute(3, 2, 0, 1))
    weight, bias = leaf(t[name + ".outc.conv.weight"].T), leaf(t[name + ".outc.conv.bias"][0])
    start = leaf(image(t[name + ".in"], width, height))

    def doubled(x):
        return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)

    h = start
    for block in ("inc", "up1.conv", "up2.conv"):
        h = h if block == "inc" else doubled(h)
        for layer in (0, 3):
            h = F.conv2d(h, kernel[f"{name}.{block}.double_conv.{layer}.weight"], padding=1)
            h = F.relu(F.instance_norm(h, eps=1e-5) if normal else h)
    z = F.conv2d(h, weight[:, :, None, None], bias)
    if skip:
        z = z + torch.logit(doubled(doubled(start[:, :3])).clamp(1e-3, 1 - 1e-3))
    y = torch.sigmoid(z)
    y.backward(image(t[name + ".g_y"], 4 * width, 4 * height))
    errors[name] = relative_error(image(t[name + ".y"], 4 * width, 4 * height), y)
    errors[name + " g_in"] = relative_error(image(t[name + ".g_in"], width, height), start.grad)
    errors[name + " g_out"] = relative_error(t[name + ".g.outc.conv.weight"].T, weight.grad)
    errors[name + " g_bias"] = relative_error(t[name + ".g.outc.conv.bias"][0], bias.grad)
    for n, k in kernel.items():
        g = k.grad.permute(2, 3, 1, 0).reshape(-1, k.shape[0])
        errors["g " + n] = relative_error(t[n.replace(name, name + ".g", 1)], g)


with tempfile.TemporaryDirectory() as folder:
    result = os.path.join(folder, "result")
    subprocess.run([sys.argv[1], result], check=True)
    tensors = read_f64(result)
check_mlp(tensors)
check_upsampler(tensors, "published", normal=True, skip=False)
check_upsampler(tensors, "skip", normal=False, skip=True)
for quantity, error in errors.items():
    print(f"{error:.1e} {quantity}")
sys.exit(0 if max(errors.values()) < 1e-10 else 1)
