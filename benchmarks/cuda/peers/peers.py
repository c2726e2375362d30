# SPDX-License-Identifier: Apache-2.0
"""peers.py FOLDER [--scenes A,B] [--peers A,B] [--calls N] [--json FILE]: rye and its peers, called
from PyTorch in one process, on the scenes that bench_scene_files wrote to FOLDER. README.md beside
this file says how to get each peer; one that is missing is named.

For each scene, sixteen cameras in turn, 20 calls before, N timed (default 200), medians in ms:
  eager    what a program waits that calls and calls again
  graph    the same as a CUDA graph, where the peer can be captured
  busy     how long any of its kernels runs, by torch.profiler: one that begins early and waits for
           the one before counts once
forward alone without gradients, and forward with the gradient of everything, given cotangents of
the image, and of alpha where the peer has one. And how far each peer's picture is from rye's at
accuracy "tight" (mean over cameras). Of gradients gradients.py tells."""

import argparse
import json
import os
import statistics
import sys

import numpy
import torch

sys.path.append(os.path.join(os.path.dirname(os.path.abspath(__file__)), "../../../examples/torch"))

NAMES = ("means", "quats", "scales", "opacities", "colors")


class Scene:
    def __init__(self, folder):
        def read(name):
            return torch.from_numpy(numpy.load(os.path.join(folder, name + ".npy")))

        self.leaves = [read(k).cuda().requires_grad_() for k in NAMES]
        self.views, self.ks = read("viewmats"), read("Ks")
        self.views_there, self.ks_there = self.views.cuda(), self.ks.cuda()
        self.width, self.height = (int(x) for x in read("size"))
        self.degree = 3 if self.leaves[4].dim() == 3 else None
        self.channels = 3 if self.degree is not None else self.leaves[4].shape[1]
        g = torch.Generator().manual_seed(4004)
        shape = (1, self.height, self.width)
        self.g_image = (torch.rand(*shape, self.channels, generator=g) * 2 - 1).cuda()
        self.g_alpha = (torch.rand(*shape, 1, generator=g) * 2 - 1).cuda()


# ---- the peers: draw(scene, k) returns image [1, H, W, D] and alpha or None ---------------------


class Rye:
    name, backward, graph = "rye", True, True

    def __init__(self, accuracy="fast"):
        from rye_torch import rasterize
        self.call, self.accuracy = rasterize, accuracy

    def prepare(self, scene):
        return True

    def draw(self, s, k, wait=None):
        image, alpha, _ = self.call(*s.leaves, s.views[k:k + 1], s.ks[k:k + 1], s.width, s.height,
                                    sh_degree=s.degree, accuracy=self.accuracy, wait=wait)
        return image, alpha


class Gsplat:
    name, backward, graph = "gsplat", True, False

    def __init__(self):
        import gsplat
        self.call, self.version = gsplat.rasterization, gsplat.__version__

    def prepare(self, scene):
        return True

    def draw(self, s, k):
        image, alpha, _ = self.call(*s.leaves, s.views_there[k:k + 1], s.ks_there[k:k + 1],
                                    s.width, s.height, sh_degree=s.degree, packed=False)
        return image, alpha


class GsplatInference:
    """gsplat's renderer in half precision, without gradients."""

    name, backward, graph = "gsplat inference", False, False

    def __init__(self):
        from gsplat.experimental.render import GaussianInferenceRenderer
        from gsplat.scene import GaussianInferenceScene
        self.renderer_of, self.scene_of = GaussianInferenceRenderer, GaussianInferenceScene

    def prepare(self, s):
        if s.channels != 3:
            return False
        means, quats, scales, opacities, colors = (x.detach().contiguous() for x in s.leaves)
        quats = torch.nn.functional.normalize(quats, dim=-1)
        made = self.scene_of.from_gaussian_tensors(means, quats, scales, opacities, colors,
                                                   s.degree, "none", id="scene")
        self.renderer = self.renderer_of(made)
        return True

    def draw(self, s, k):
        with torch.inference_mode():
            frame = self.renderer.render(viewmat=s.views_there[k], K=s.ks_there[k], width=s.width,
                                         height=s.height).frame
        return frame[..., :3], None


class FasterGs:
    """It takes parameters before their activations, and has no alpha."""

    name, backward, graph = "Faster-GS", True, False

    def __init__(self):
        from FasterGSCudaBackend.torch_bindings.rasterization import (RasterizerSettings,
                                                                      diff_rasterize)
        self.call, self.settings_of = diff_rasterize, RasterizerSettings

    def prepare(self, s):
        if s.channels != 3:
            return False
        means, quats, scales, opacities, colors = (x.detach() for x in s.leaves)
        if s.degree is None:
            first, rest, bases = (colors - 0.5)[:, None] / 0.28209479177387814, colors.new_empty(
                (colors.shape[0], 0, 3)), 1
        else:
            first, rest, bases = colors[:, :1], colors[:, 1:], 16
        self.raw = [x.contiguous().requires_grad_() for x in (
            means, scales.log(), quats, torch.logit(opacities)[:, None], first, rest)]
        self.settings = []
        for view, k in zip(s.views, s.ks):
            eye = -(view[:3, :3].T @ view[:3, 3])
            self.settings.append(self.settings_of(
                view.cuda(), eye.cuda(), torch.zeros(3, device="cuda"), bases, s.width, s.height,
                k[0, 0].item(), k[1, 1].item(), k[0, 2].item(), k[1, 2].item(), 0.01, 1e10, False))
        self.none = torch.empty(0)
        return True

    def draw(self, s, k):
        image = self.call(*self.raw, self.none, self.settings[k])
        return image.permute(1, 2, 0)[None], None


PEERS = {"rye": Rye, "gsplat": Gsplat, "gsplat-inference": GsplatInference, "faster-gs": FasterGs}


# ---- measuring -------------------------------------------------------------------------------


def leaves_of(peer, scene):
    return [t for t in getattr(peer, "raw", scene.leaves) if t.numel() > 0]


def forward(peer, scene, k, **how):
    with torch.no_grad():
        return peer.draw(scene, k, **how)


def both(peer, scene, k, **how):
    image, alpha = peer.draw(scene, k, **how)
    outputs = [(image, scene.g_image)] + ([(alpha, scene.g_alpha)] if alpha is not None else [])
    return torch.autograd.grad([o for o, _ in outputs], leaves_of(peer, scene),
                               [g.expand_as(o) for o, g in outputs])


def median_ms(call, calls):
    for k in range(20):
        call(k % 16)
    events = [torch.cuda.Event(enable_timing=True) for _ in range(calls + 1)]
    torch.cuda.synchronize()
    events[0].record()
    for k in range(calls):
        call(k % 16)
        events[k + 1].record()
    torch.cuda.synchronize()
    return statistics.median(a.elapsed_time(b) for a, b in zip(events, events[1:]))


def busy_ms(call):
    from torch.profiler import ProfilerActivity, profile
    calls = 32
    with profile(activities=[ProfilerActivity.CUDA], acc_events=True) as record:
        for k in range(calls):
            call(k % 16)
        torch.cuda.synchronize()
    spans = sorted((e.time_range.start, e.time_range.end) for e in record.events()
                   if e.device_type != torch.autograd.DeviceType.CPU)
    total, until = 0.0, float("-inf")
    for start, end in spans:
        total += max(0.0, end - max(start, until))
        until = max(until, end)
    return total / 1000 / calls


def graph_ms(peer, scene, what, calls):
    graphs = []
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for k in range(16):  # room for every camera
            what(peer, scene, k, wait=True)
    torch.cuda.current_stream().wait_stream(side)
    pool, kept = None, []
    for k in range(16):
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=pool):
            kept.append(what(peer, scene, k, wait=False))
        pool = graph.pool()
        graphs.append(graph)
    return median_ms(lambda k: graphs[k].replay(), calls)


def psnr(a, b):
    return -10 * torch.log10((a.float().clamp(0, 1) - b.clamp(0, 1)).square().mean()).item()


def measure(peer, scene, calls, exact):
    row = {}
    with torch.no_grad():
        row["psnr"] = statistics.mean(
            psnr(peer.draw(scene, k)[0], exact.draw(scene, k)[0]) for k in range(16))
    row["forward_eager"] = median_ms(lambda k: forward(peer, scene, k), calls)
    row["forward_busy"] = busy_ms(lambda k: forward(peer, scene, k))
    if peer.backward:
        row["both_eager"] = median_ms(lambda k: both(peer, scene, k), calls)
        row["both_busy"] = busy_ms(lambda k: both(peer, scene, k))
    if peer.graph:
        row["forward_graph"] = graph_ms(peer, scene, forward, calls)
        row["both_graph"] = graph_ms(peer, scene, both, calls)
    return row


def main():
    options = argparse.ArgumentParser()
    options.add_argument("folder")
    options.add_argument("--scenes", default="head100k_c3,head100k_c32,head300k_c3,scene1m")
    options.add_argument("--peers", default=",".join(PEERS))
    options.add_argument("--calls", type=int, default=200)
    options.add_argument("--json")
    options = options.parse_args()
    torch.manual_seed(1)
    print(f"{torch.cuda.get_device_name()}, PyTorch {torch.__version__}; ms, medians of "
          f"{options.calls}")
    peers = []
    for name in options.peers.split(","):
        try:
            peers.append(PEERS[name]())
            print(f"{peers[-1].name} {getattr(peers[-1], 'version', '')}")
        except Exception as e:
            print(f"{name}: not run: {type(e).__name__}: {str(e)[:300]}")
    exact = Rye("tight")
    results = {}
    for name in options.scenes.split(","):
        scene = Scene(os.path.join(options.folder, name))
        for peer in peers:
            try:
                if not peer.prepare(scene):
                    continue
                row = measure(peer, scene, options.calls, exact)
            except Exception as e:
                print(f"{name}, {peer.name}: failed: {type(e).__name__}: {str(e)[:300]}")
                continue
            results[f"{name}, {peer.name}"] = row
            text = ", ".join(f"{k} {v:.4g}" for k, v in row.items())
            print(f"{name}, {peer.name}: {text}", flush=True)
    if options.json:
        with open(options.json, "w") as f:
            json.dump({"device": torch.cuda.get_device_name(), "torch": torch.__version__,
                       "results": results}, f, indent=1)


if __name__ == "__main__":
    main()
