# SPDX-License-Identifier: Apache-2.0
"""gradients.py FILE [--pixels N]: errors of pictures and gradients of rye and of gsplat against
every Gaussian in double precision (tests/torch/plain.py), on gsplat's own test scene: FILE is
assets/test_garden.npz of its repository. First camera, random shapes and opacities by a seed, the
Gaussians in front of the camera and not far beside the picture; a random cotangent at N pixels
(default 4000) and of their alphas. Of gradients the norm of the error over the norm."""

import argparse
import os
import sys

import numpy
import torch

here = os.path.dirname(os.path.abspath(__file__))
sys.path += [os.path.join(here, "../../..", folder) for folder in ("examples/torch", "tests/torch")]

import plain
from rye_torch import rasterize

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
NAMES = ("means", "quats", "scales", "opacities", "colors")


def scene(file):
    data = numpy.load(file)
    g = torch.Generator().manual_seed(1)
    means = torch.from_numpy(data["means3d"]).float()
    colors = torch.from_numpy(data["colors"] / 255.0).float()
    view = torch.from_numpy(data["viewmats"]).float()[:1]
    k = torch.from_numpy(data["Ks"]).float()[:1]
    width, height = data["width"].item(), data["height"].item()
    at = means @ view[0, :3, :3].T + view[0, :3, 3]
    u, v = (at[:, :2] / at[:, 2:] * k[0, [0, 1], [0, 1]] + k[0, :2, 2]).unbind(-1)
    seen = (at[:, 2] > 0.2) & (u > -0.1 * width) & (u < 1.1 * width) & (v > -0.1 * height) & (
        v < 1.1 * height)
    # Of several at the same depth no order is right.
    _, of, count = at[:, 2].unique(return_inverse=True, return_counts=True)
    seen &= count[of] == 1
    means, colors = means[seen], colors[seen]
    n = means.shape[0]
    leaves = [means, torch.randn(n, 4, generator=g), 0.02 * torch.rand(n, 3, generator=g) + 1e-4,
              torch.rand(n, generator=g), colors]
    return [t.to(DEVICE).requires_grad_() for t in leaves], view, k, width, height


def main():
    options = argparse.ArgumentParser()
    options.add_argument("file")
    options.add_argument("--pixels", type=int, default=4000)
    options = options.parse_args()
    leaves, view, k, width, height = scene(options.file)
    g = torch.Generator().manual_seed(2)
    at = torch.randperm(width * height, generator=g)[:options.pixels].to(DEVICE)
    g_image = torch.zeros(width * height, 3, device=DEVICE)
    g_alpha = torch.zeros(width * height, 1, device=DEVICE)
    g_image[at] = (torch.rand(options.pixels, 3, generator=g) * 2 - 1).to(DEVICE)
    g_alpha[at] = (torch.rand(options.pixels, 1, generator=g) * 2 - 1).to(DEVICE)

    double = [t.detach().double().requires_grad_() for t in leaves]
    pixels = torch.stack([at % width, at // width], -1).double() + 0.5
    pictures, alphas, want = [], [], [torch.zeros_like(t) for t in double]
    for chunk in range(0, options.pixels, 64):
        part = slice(chunk, chunk + 64)
        projected = plain.project(*double[:4], *(t[0].double().to(DEVICE) for t in (view, k)))
        picture, alpha = plain.blend(projected, double[4], pixels[part])
        grads = torch.autograd.grad([picture, alpha], double,
                                    [g_image[at[part]].double(), g_alpha[at[part]].double()])
        want = [a + b for a, b in zip(want, grads)]
        pictures.append(picture.detach())
        alphas.append(alpha.detach())
    picture, alpha = torch.cat(pictures), torch.cat(alphas)

    def rye(accuracy):
        return lambda: rasterize(*leaves, view, k, width, height, accuracy=accuracy)[:2]

    peers = {f"rye, {a}": rye(a) for a in ("fast", "balanced", "tight", "3dgs")}
    try:
        from gsplat import rasterization
        peers["gsplat"] = lambda: rasterization(*leaves, view.to(DEVICE), k.to(DEVICE), width,
                                                height, packed=False)[:2]
    except ImportError as e:
        print(f"gsplat: not run: {e}")
    print(f"{leaves[0].shape[0]} Gaussians, {width} x {height}, {options.pixels} pixels")
    for name, draw in peers.items():
        image, opacity = draw()
        got = torch.autograd.grad([image, opacity], leaves, [g_image.view_as(image),
                                                            g_alpha.view_as(opacity)])
        off = (image.detach().reshape(-1, 3)[at] - picture).abs()
        errors = ", ".join(f"{n} {((a - b).norm() / b.norm()).item():.1e}"
                           for n, a, b in zip(NAMES, got, want))
        print(f"{name}: picture at most {off.max().item():.1e}, mean {off.mean().item():.1e}; "
              f"gradients: {errors}", flush=True)


if __name__ == "__main__":
    main()
