# SPDX-License-Identifier: Apache-2.0
"""test_rye_torch.py: rye_torch.py against plain.py, on a CUDA device, or with the library that is
compiled for the host. Arguments: none. $RYE_DEVICE_LIBRARY names the library."""

import os
import sys

here = os.path.dirname(os.path.abspath(__file__))
sys.path += [here, os.path.join(here, "../../examples/torch")]
try:
    import torch
except ImportError:
    print("skipped: no PyTorch is there")
    sys.exit(77)

import plain
import rye_torch
from rye_torch import rasterize

rye_torch._load()
DEVICE = "cpu" if rye_torch._library.rye_device_is_host() else "cuda"
if DEVICE == "cuda" and not torch.cuda.is_available():
    print("skipped: no device is there")
    sys.exit(77)
WIDTH, HEIGHT = 40, 32


def scene(n=60, channels=3, cameras=1, seed=1):
    """Leaves in float on the device, and views on the host."""
    g = torch.Generator().manual_seed(seed)

    def random(*shape):
        return torch.rand(*shape, generator=g) * 2 - 1

    arrays = {"means": 0.6 * random(n, 3), "quats": random(n, 4) + torch.tensor([1.5, 0, 0, 0]),
              "scales": 0.12 + 0.05 * random(n, 3), "opacities": 0.5 + 0.4 * random(n),
              "colors": random(n, channels)}
    leaves = {k: v.to(DEVICE).requires_grad_() for k, v in arrays.items()}
    views = torch.eye(4).repeat(cameras, 1, 1)
    for c in range(cameras):
        t = torch.tensor(0.3 * c)
        views[c, :3, :3] = torch.tensor([[torch.cos(t), 0, torch.sin(t)], [0, 1, 0],
                                         [-torch.sin(t), 0, torch.cos(t)]])
        views[c, 2, 3] = 4 + 0.2 * c
    ks = torch.tensor([[60.0, 0, 21], [0, 55, 15], [0, 0, 1]]).repeat(cameras, 1, 1)
    return leaves, views, ks


def close(name, got, want, bound):
    want = want.to(torch.float64).cpu()
    apart = (got.detach().double().cpu() - want).abs().max() / want.abs().max().clamp(min=1e-12)
    assert apart <= bound, f"{name}: differs by {apart:.2e}, expected at most {bound:.0e}"


def against_plain(leaves, views, ks, degree=None, backgrounds=None, antialiased=False,
                  accuracy="tight"):
    double = {k: v.detach().double().cpu().requires_grad_() for k, v in leaves.items()}
    back = None if backgrounds is None else backgrounds.detach().double().cpu().requires_grad_()
    images, alphas, _ = rasterize(
        *leaves.values(), views, ks, WIDTH, HEIGHT, sh_degree=degree, backgrounds=backgrounds,
        rasterize_mode="antialiased" if antialiased else "classic", accuracy=accuracy)
    g = torch.Generator().manual_seed(9)
    g_images = torch.rand(images.shape, generator=g) * 2 - 1
    g_alphas = torch.rand(alphas.shape, generator=g) * 2 - 1
    loss = 0
    for c in range(views.shape[0]):
        view, k = views[c].double(), ks[c].double()
        colors = double["colors"]
        if degree is not None:
            eye = -view[:3, :3].T @ view[:3, 3]
            colors = plain.harmonic_colors(colors, degree, double["means"], eye)
        elif colors.dim() == 3:
            colors = colors[c]
        picture, alpha = plain.draw(double["means"], double["quats"], double["scales"],
                                    double["opacities"], colors, view, k, WIDTH, HEIGHT,
                                    None if back is None else back[c], antialiased=antialiased)
        close("image", images[c], picture, 1e-3)
        close("alpha", alphas[c], alpha, 1e-3)
        loss = loss + (picture * g_images[c].double()).sum() + (alpha * g_alphas[c].double()).sum()
    loss.backward()
    ((images * g_images.to(DEVICE)).sum() + (alphas * g_alphas.to(DEVICE)).sum()).backward()
    for name, leaf in leaves.items():
        close(name, leaf.grad, double[name].grad, 5e-3)
    if backgrounds is not None:
        close("backgrounds", backgrounds.grad, back.grad, 5e-3)


def test_one_camera():
    against_plain(*scene())


def test_many_channels():
    against_plain(*scene(channels=37))


def test_cameras_and_backgrounds():
    backgrounds = torch.rand(3, 5).to(DEVICE).requires_grad_()
    against_plain(*scene(channels=5, cameras=3), backgrounds=backgrounds)


def test_colors_of_each_camera():
    leaves, views, ks = scene(cameras=2)
    leaves["colors"] = torch.rand(2, 60, 3).to(DEVICE).requires_grad_()
    against_plain(leaves, views, ks)


def test_harmonics():
    for degree, bases in ((0, 1), (1, 4), (2, 16)):
        leaves, views, ks = scene(cameras=2)
        leaves["colors"] = (torch.rand(60, bases, 3) - 0.5).to(DEVICE).requires_grad_()
        against_plain(leaves, views, ks, degree=degree)
        assert (leaves["colors"].grad[:, (degree + 1) ** 2:] == 0).all()


def test_antialiased():
    leaves, views, ks = scene()
    with torch.no_grad():
        leaves["scales"] *= 0.2
    against_plain(leaves, views, ks, antialiased=True)


def test_depth():
    leaves, views, ks = scene(cameras=2)
    for mode in ("D", "ED", "RGB+D", "RGB+ED"):
        images, alphas, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT, render_mode=mode,
                                      accuracy="tight")
        assert images.shape[-1] == (4 if "+" in mode else 1)
        depth = images[..., -1]
        for c in range(2):
            means = leaves["means"].detach().double().cpu()
            z = means @ views[c, 2, :3].double() + views[c, 2, 3].double()
            want, alpha = plain.draw(means, *(leaves[k].detach().double().cpu() for k in
                                              ("quats", "scales", "opacities")), z[:, None],
                                     views[c].double(), ks[c].double(), WIDTH, HEIGHT)
            if "E" in mode:
                seen = alpha[..., 0] > 0.1
                close(mode, depth[c].cpu()[seen], (want / alpha)[..., 0][seen], 1e-3)
            else:
                close(mode, depth[c], want[..., 0], 1e-3)
        leaves["means"].grad = None
        depth.sum().backward()
        assert torch.isfinite(leaves["means"].grad).all() and (leaves["means"].grad != 0).any()
    leaves["colors"] = (torch.rand(60, 4, 3) - 0.5).to(DEVICE).requires_grad_()
    images, _, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT, render_mode="RGB+D",
                             sh_degree=1)
    assert images.shape == (2, HEIGHT, WIDTH, 4)


def test_same_bits():
    leaves, views, ks = scene(n=500)
    grads = []
    for _ in range(3):
        images, _, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT)
        grads.append(torch.autograd.grad(images.square().sum(), list(leaves.values()),
                                         retain_graph=True))
        grads.append(torch.autograd.grad(images.square().sum(), list(leaves.values())))
    for other in grads[1:]:
        assert all(torch.equal(a, b) for a, b in zip(grads[0], other))


def test_only_what_is_asked_for():
    leaves, views, ks = scene()
    images, _, info = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT)
    (alone,) = torch.autograd.grad(images.sum(), [leaves["opacities"]])
    images, _, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT)
    images.sum().backward()
    assert torch.equal(alone, leaves["opacities"].grad)
    cost = info["frames"][0].cost()
    assert cost["fits"] and cost["entries"] > 0 and cost["skipped"] == 0 and cost["bytes"] > 0
    with torch.no_grad():
        images, _, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT)
        assert images.grad_fn is None and torch.isfinite(images).all()


def test_frames_are_used_again():
    leaves, views, ks = scene(n=61)
    for _ in range(5):
        images, alphas, info = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT,
                                         accuracy="fast")
        images.sum().backward()
    renderer = info["frames"][0].renderer
    del images, alphas, info
    assert 1 <= len(renderer.free) <= 2, len(renderer.free)


def test_what_does_not_fit():
    leaves, views, ks = scene(n=100)
    images, _, _ = rasterize(*leaves.values(), views, ks, 400, 400, eps2d=0.25)
    images.sum().backward()  # the size is known now
    leaves["scales"] = torch.full((100, 3), 30.0, device=DEVICE, requires_grad=True)
    images, _, info = rasterize(*leaves.values(), views, ks, 400, 400, eps2d=0.25)
    try:
        images.sum().backward()
        raise AssertionError("backward of a frame that did not fit")
    except rye_torch.DidNotFit:
        assert torch.isnan(images).all()
    images, _, _ = rasterize(*leaves.values(), views, ks, 400, 400, eps2d=0.25)
    images.sum().backward()
    assert torch.isfinite(images).all()
    images, _, _ = rasterize(*leaves.values(), views, ks, 400, 400, eps2d=0.24, wait=True)
    assert torch.isfinite(images).all()


def test_needs_are_known_only_by_waiting():
    leaves, views, ks = scene(n=90)
    leaves["scales"] = torch.full((90, 3), 30.0, device=DEVICE, requires_grad=True)
    images, _, _ = rasterize(*leaves.values(), views, ks, 416, 416, eps2d=0.22, wait=False)
    assert torch.isnan(images).all()
    images, _, _ = rasterize(*leaves.values(), views, ks, 416, 416, eps2d=0.22)
    images.sum().backward()
    assert torch.isfinite(images).all()


def test_arguments():
    leaves, views, ks = scene()

    def refused(error, words, **changes):
        a = {**leaves, "viewmats": views, "Ks": ks, "width": WIDTH, "height": HEIGHT, **changes}
        try:
            rasterize(**a)
        except error as e:
            assert words in str(e), e
            return
        raise AssertionError(f"{words}: no {error.__name__}")

    refused(ValueError, "quats: got the shape [60, 3]", quats=leaves["means"])
    refused(TypeError, "scales: got torch.float64", scales=leaves["scales"].double())
    refused(ValueError, "colors", colors=leaves["colors"][:5])
    refused(ValueError, "expected [60, 9, 3]", sh_degree=2, colors=leaves["colors"][:, None])
    refused(ValueError, "accuracy", accuracy="best")
    refused(ValueError, "render_mode", render_mode="RGBA")
    refused(NotImplementedError, "no gradient", viewmats=views.clone().requires_grad_())
    skew = ks.clone()
    skew[0, 0, 1] = 0.5
    refused(ValueError, "skew", Ks=skew)
    refused(rye_torch.Error, "last row", viewmats=2 * views)
    wide = views.clone()
    wide[:, :3, :3] *= 2
    refused(rye_torch.Error, "rotation", viewmats=wide)
    refused(rye_torch.Error, "near_depth", near_plane=0.0)
    other = torch.device("meta")
    refused(ValueError, "is on meta", means=leaves["means"].detach().to(other))


def test_graph_and_streams():
    if DEVICE == "cpu":
        return
    leaves, views, ks = scene(n=300)

    def step(wait=False):
        images, _, _ = rasterize(*leaves.values(), views, ks, WIDTH, HEIGHT, wait=wait)
        return torch.autograd.grad(images.square().sum(), list(leaves.values()))

    want = step(wait=None)  # nothing of its graph may live when another one is captured
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(3):
            got = step()
    torch.cuda.current_stream().wait_stream(side)
    assert all(torch.equal(a, b) for a, b in zip(got, want))
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        got = step()
    graph.replay()
    torch.cuda.synchronize()
    assert all(torch.equal(a, b) for a, b in zip(got, want))


if __name__ == "__main__":
    tests = [(k, f) for k, f in list(globals().items()) if k.startswith("test_")]
    for name, test in tests:
        test()
        print(name)
    print(f"{len(tests)} passed on {DEVICE}")
