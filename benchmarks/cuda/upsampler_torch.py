# SPDX-License-Identifier: Apache-2.0
"""upsampler_torch.py: the super-resolution of bench_cuda_upsampler by PyTorch and cuDNN on this
device, for a comparison in one run: 128 -> 512 and 512 -> 2048, 32 channels, capacity 32, bf16,
channels last, captured as a CUDA graph. Milliseconds, median of 100 [least-most], and TFLOP/s of
the convolutions' own products. cuDNN searches for its fastest kernels first."""

import statistics
import sys

try:
    import torch
    from torch import nn
except ImportError:
    print("not run: PyTorch is not installed")
    sys.exit(0)
if not torch.cuda.is_available():
    print("not run: PyTorch finds no CUDA device")
    sys.exit(0)


class Block(nn.Module):
    """Doubles its input unless it is the first, then twice convolution, InstanceNorm, ReLU."""

    def __init__(self, inputs, outputs, doubles):
        super().__init__()
        self.doubles = doubles
        pair = []
        for i in (inputs, outputs):
            pair += [nn.Conv2d(i, outputs, 3, padding=1, bias=False), nn.InstanceNorm2d(outputs),
                     nn.ReLU(inplace=True)]
        self.pair = nn.Sequential(*pair)

    def forward(self, x):
        if self.doubles:
            x = nn.functional.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)
        return self.pair(x)


def upsampler(channels=32, capacity=32, doublings=2):
    widths = [capacity << (doublings - b) for b in range(doublings + 1)]
    blocks = [Block(channels, widths[0], False)]
    blocks += [Block(widths[b], widths[b + 1], True) for b in range(doublings)]
    return nn.Sequential(*blocks, nn.Conv2d(capacity, 3, 1), nn.Sigmoid())


def flops_of(side, channels=32, capacity=32, doublings=2):
    total, width = 0.0, channels
    for block in range(doublings + 1):
        out = capacity << (doublings - block)
        pixels = (side << block) ** 2
        total += 2 * 9.0 * pixels * (width * out + out * out)
        width = out
    return total


def graph_times(work, repeats=100):
    """Milliseconds of each of `repeats` launches of a graph of work()."""
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(5):
            work()
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        work()
    times = []
    for _ in range(repeats + 10):
        begin, end = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
        begin.record()
        graph.replay()
        end.record()
        end.synchronize()
        times.append(begin.elapsed_time(end))
    return times[10:]


def report(name, times, flops):
    median = statistics.median(times)
    print(f"{name:36} {median:8.3f} ms [{min(times):.3f}-{max(times):.3f}] "
          f"{flops / median * 1e-9:6.0f} TFLOP/s", flush=True)


def main():
    torch.backends.cudnn.benchmark = True
    print(f"PyTorch {torch.__version__}, cuDNN {torch.backends.cudnn.version()}, "
          f"{torch.cuda.get_device_name()}")
    for side in (128, 512):
        net = upsampler().cuda().to(torch.bfloat16).to(memory_format=torch.channels_last)
        x = torch.rand(1, 32, side, side, device="cuda", dtype=torch.bfloat16)
        x = x.to(memory_format=torch.channels_last).requires_grad_()
        g = torch.rand(1, 3, 4 * side, 4 * side, device="cuda", dtype=torch.bfloat16)
        parameters = [x, *net.parameters()]

        def forward():
            with torch.no_grad():
                net(x)

        def both():
            torch.autograd.grad(net(x), parameters, g)

        name = f"cudnn/{side}-{4 * side}/bf16"
        report(f"{name}/forward", graph_times(forward), flops_of(side))
        report(f"{name}/both", graph_times(both), 3 * flops_of(side))


if __name__ == "__main__":
    main()
