#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""lpips_torch.py PROGRAM CONVERTER_DIR: rye's LPIPS against PyTorch's autograd, on random weights.

Writes random weights through the converter, and two random images; runs PROGRAM (lpips.cpp) on
them; computes value and gradient with torch from the definition of LPIPS 0.1.4 (net = 'vgg',
normalize = True), and compares in float64. Exit status 77 means that torch is not installed.
"""
import os
import subprocess
import sys
import tempfile

sys.dont_write_bytecode = True
from tensors import read_f64, relative_error, torch  # noqa: E402

import torch.nn.functional as F  # noqa: E402

sys.path.insert(0, sys.argv[2])
from convert_lpips_weights import CONVOLUTIONS, rye_tensors, write_safetensors  # noqa: E402

CHANNELS = (64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512)
SLICE_ENDS = (1, 3, 6, 9, 12)


def features(vgg, x):
    out = []
    for k, i in enumerate(CONVOLUTIONS):
        x = F.relu(F.conv2d(x, vgg[f"features.{i}.weight"], vgg[f"features.{i}.bias"], padding=1))
        if k in SLICE_ENDS:
            out.append(x)
            x = F.max_pool2d(x, 2)
    return out


def lpips(vgg, lin, a, b):
    shift = torch.tensor([-0.030, -0.088, -0.188], dtype=torch.float64).reshape(1, 3, 1, 1)
    scale = torch.tensor([0.458, 0.448, 0.450], dtype=torch.float64).reshape(1, 3, 1, 1)
    fa, fb = (features(vgg, (2 * x - 1 - shift) / scale) for x in (a, b))
    total = 0
    for s in range(5):
        na, nb = (f / (f.pow(2).sum(1, keepdim=True).sqrt() + 1e-10) for f in (fa[s], fb[s]))
        total = total + F.conv2d((na - nb) ** 2, lin[f"lin{s}.model.1.weight"]).mean()
    return total


def main():
    torch.manual_seed(1)
    vgg, lin, channels = {}, {}, 3
    for i, out in zip(CONVOLUTIONS, CHANNELS):
        vgg[f"features.{i}.weight"] = torch.randn(out, channels, 3, 3) * (2 / (9 * channels)) ** 0.5
        vgg[f"features.{i}.bias"] = 0.1 * torch.randn(out)
        channels = out
    for s, k in enumerate(SLICE_ENDS):
        lin[f"lin{s}.model.1.weight"] = torch.rand(1, CHANNELS[k], 1, 1)
    width, height = 45, 34
    a, b = (torch.rand(1, 3, height, width, dtype=torch.float64) for _ in range(2))
    a.requires_grad_(True)

    with tempfile.TemporaryDirectory() as folder:
        weights, images, result = (os.path.join(folder, n) for n in ("weights", "images", "result"))
        write_safetensors(weights, rye_tensors(vgg, lin))
        pixels = {n: x.detach()[0].permute(1, 2, 0).reshape(-1, 3).contiguous()
                  for n, x in (("a", a), ("b", b))}
        write_safetensors(images, pixels)
        subprocess.run([sys.argv[1], weights, images, str(width), str(height), result], check=True)
        got = read_f64(result)

    vgg, lin = ({n: t.double() for n, t in d.items()} for d in (vgg, lin))
    value = lpips(vgg, lin, a, b)
    value.backward()
    expected = a.grad[0].permute(1, 2, 0).reshape(-1, 3)
    value_error = relative_error(got["value"].reshape(()), value.detach())
    gradient_error = relative_error(got["gradient"], expected)
    print(f"value {value.item():.6f}, relative error {value_error:.2e}, gradient {gradient_error:.2e}")
    sys.exit(0 if value_error < 1e-10 and gradient_error < 1e-8 else 1)


if __name__ == "__main__":
    main()
