# SPDX-License-Identifier: Apache-2.0
"""fit.py [--by rye|gsplat] [--seconds S] [--gaussians N]: fits Gaussians to 16 pictures of a cloud,
as a program of PyTorch does: Adam, L1, a random view a step. Prints the PSNR over all views by the
time that the steps took. The pictures are drawn by rye at accuracy "tight"."""

import argparse
import math
import time

import torch

from rye_torch import rasterize

WIDTH = HEIGHT = 512


def views(count):
    """Cameras on a circle around the origin that look at it: x right, y down, z forward."""
    made = torch.eye(4).repeat(count, 1, 1)
    for k in range(count):
        t = 2 * math.pi * k / count
        made[k, :3, :3] = torch.tensor([[math.cos(t), 0, -math.sin(t)], [0, -1, 0],
                                        [-math.sin(t), 0, -math.cos(t)]])
        made[k, 2, 3] = 3.5
    ks = torch.tensor([[860.0, 0, WIDTH / 2], [0, 860, HEIGHT / 2], [0, 0, 1]])
    return made, ks.repeat(count, 1, 1)


def cloud(n, generator):
    """Parameters of small Gaussians around a ball's surface, before their activations."""
    def random(*shape):
        return torch.randn(*shape, generator=generator)

    means = torch.nn.functional.normalize(random(n, 3), dim=-1) * (1 + 0.02 * random(n, 1))
    colors = torch.sigmoid(2 * torch.sin(4 * means) + 0.3 * random(n, 3))
    return [means, random(n, 4), math.log(0.012) + 0.3 * random(n, 3), 1.5 * random(n),
            torch.logit(colors, eps=1e-3)]


def activated(raw):
    means, quats, scales, opacities, colors = raw
    return means, quats, scales.exp(), opacities.sigmoid(), colors.sigmoid()


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--by", default="rye", choices=["rye", "gsplat"])
    options.add_argument("--seconds", type=float, default=30)
    options.add_argument("--gaussians", type=int, default=100000)
    options = options.parse_args()
    device = "cuda" if torch.cuda.is_available() else "cpu"
    generator = torch.Generator().manual_seed(1)
    on_host, ks = views(16)
    with torch.no_grad():
        truth = activated([t.to(device) for t in cloud(options.gaussians, generator)])
        photographs, _, _ = rasterize(*truth, on_host, ks, WIDTH, HEIGHT, accuracy="tight")
    raw = [t.to(device).requires_grad_() for t in cloud(options.gaussians, generator)]
    adam = torch.optim.Adam([{"params": [p], "lr": lr}
                             for p, lr in zip(raw, (2e-4, 1e-3, 5e-3, 2e-2, 1e-2))], eps=1e-15)

    if options.by == "rye":
        def draw(k):
            return rasterize(*activated(raw), on_host[k], ks[k], WIDTH, HEIGHT)[0]
    else:
        from gsplat import rasterization
        there, ks_there = on_host.to(device), ks.to(device)

        def draw(k):
            return rasterization(*activated(raw), there[k], ks_there[k], WIDTH, HEIGHT,
                                 packed=False)[0]

    def psnr():
        with torch.no_grad():
            errors = [(draw([k]) - photographs[k]).square().mean() for k in range(16)]
            return -10 * torch.log10(torch.stack(errors).mean()).item()

    def wait():
        if device == "cuda":
            torch.cuda.synchronize()

    print(f"{options.by}: {psnr():.2f} dB before")
    order = torch.randint(16, (1 << 20,), generator=generator).tolist()
    step, spent, report = 0, 0.0, 1.0
    while spent < options.seconds:
        wait()
        begin = time.perf_counter()
        for _ in range(20):
            k = order[step % len(order)]
            loss = (draw([k]) - photographs[k]).abs().mean()
            adam.zero_grad(set_to_none=True)
            loss.backward()
            adam.step()
            step += 1
        wait()
        spent += time.perf_counter() - begin
        if spent >= min(report, options.seconds):
            print(f"{options.by}: {spent:6.1f} s, {step:6d} steps, {psnr():.2f} dB", flush=True)
            report *= 2


if __name__ == "__main__":
    main()
