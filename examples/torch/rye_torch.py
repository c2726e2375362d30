# SPDX-License-Identifier: Apache-2.0
"""rye_torch.py: rye's rasterizer of 3D Gaussians for PyTorch. One file, nothing to compile but the
library rye_device (cmake -DRYE_CUDA=ON, target rye_device), which it calls by ctypes.

    from rye_torch import rasterize
    images, alphas, info = rasterize(means, quats, scales, opacities, colors, viewmats, Ks,
                                     width, height)
    loss(images).backward()

Arguments have the names of gsplat's `rasterization` where they mean the same. Tensors are read and
written where they are, on the current stream; memory comes from PyTorch's allocator. The same input
gives the same bits, gradients too. There is no gradient of cameras.

The library is $RYE_DEVICE_LIBRARY, or librye_device.so beside this file or on the loader's path.
"""

import contextlib
import ctypes
import os

import torch

__all__ = ["rasterize", "Error", "DidNotFit"]


class Error(RuntimeError):
    """What the library says of an argument."""


class DidNotFit(Error):
    """A frame needed more memory than it had, which is known only after it was drawn: its pixels
    were NaN. There is room now; draw it again."""


# ---- the library -----------------------------------------------------------------------------

_POINTER, _INT, _LONG, _FLOAT = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_float
_ALLOCATE = ctypes.CFUNCTYPE(_POINTER, _POINTER, ctypes.c_size_t, _POINTER)
_RELEASE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)


def _struct(name, *fields):
    """A struct of the C interface: it begins with its size."""
    fields = [("struct_size", ctypes.c_uint32), *fields]
    made = type(name, (ctypes.Structure,), {"_fields_": fields})
    size = ctypes.sizeof(made)

    def begin(self, **values):
        ctypes.Structure.__init__(self, struct_size=size, **values)

    made.__init__ = begin
    return made


_Options = _struct("Options", ("accuracy", _INT), ("antialias", _INT), ("dilation", _FLOAT),
                   ("context", _POINTER), ("allocate", _ALLOCATE), ("release", _RELEASE))
_Camera = _struct("Camera", ("width", _INT), ("height", _INT), ("fx", _FLOAT), ("fy", _FLOAT),
                  ("cx", _FLOAT), ("cy", _FLOAT), ("near_depth", _FLOAT),
                  ("camera_from_world", _FLOAT * 16))
_Cloud = _struct("Cloud", ("channels", _INT), ("count", _LONG), ("mean", _POINTER),
                 ("rotation", _POINTER), ("scale", _POINTER), ("opacity", _POINTER),
                 ("feature", _POINTER), ("harmonics", _POINTER), ("bases", _INT),
                 ("degree", _INT))
_Image = _struct("Image", ("feature", _POINTER), ("alpha", _POINTER))
_CloudGradient = _struct("CloudGradient", ("mean", _POINTER), ("rotation", _POINTER),
                         ("scale", _POINTER), ("opacity", _POINTER), ("feature", _POINTER),
                         ("harmonics", _POINTER), ("background", _POINTER))
_Cost = _struct("Cost", ("fits", _INT), ("entries", _LONG), ("groups", _LONG), ("skipped", _LONG),
                ("bytes", _LONG))

_FUNCTIONS = {
    "rye_device_renderer_create": [_POINTER, _POINTER],
    "rye_device_frame_create": [_POINTER, _POINTER],
    "rye_device_frame_room": [_POINTER, _LONG, _LONG],
    "rye_device_draw": [_POINTER, _POINTER, _POINTER, _POINTER, _POINTER, _INT, _POINTER],
    "rye_device_finish": [_POINTER, _INT, _POINTER],
    "rye_device_gradient": [_POINTER, _POINTER, _POINTER, _POINTER],
}
_library = None
_failure = None  # of a callback, which C cannot hand on


def _load():
    global _library
    if _library is None:
        beside = os.path.join(os.path.dirname(os.path.abspath(__file__)), "librye_device.so")
        name = os.environ.get("RYE_DEVICE_LIBRARY")
        name = name or (beside if os.path.exists(beside) else "librye_device.so")
        try:
            library = ctypes.CDLL(name)
        except OSError as e:
            raise Error(f"{e}: build it by cmake -DRYE_CUDA=ON, target rye_device, and name it by "
                        "RYE_DEVICE_LIBRARY") from None
        for function, arguments in _FUNCTIONS.items():
            getattr(library, function).argtypes = arguments
            getattr(library, function).restype = _INT
        library.rye_device_frame_destroy.argtypes = [_POINTER]
        library.rye_device_frame_destroy.restype = None
        library.rye_device_message.restype = ctypes.c_char_p
        _library = library
    return _library


def _check(status):
    global _failure
    failure, _failure = _failure, None
    if failure is not None:
        raise failure
    if status != 0:
        raise Error(_library.rye_device_message().decode())


# ---- memory ----------------------------------------------------------------------------------

_host = {}  # memory for the library that is compiled for the host


@_ALLOCATE
def _allocate(_, size, stream):
    global _failure
    try:
        if _library.rye_device_is_host():
            tensor = torch.empty(size + 256, dtype=torch.uint8)
            at = (tensor.data_ptr() + 255) // 256 * 256
            _host[at] = tensor
            return at
        return torch.cuda.caching_allocator_alloc(size, stream=stream or 0)
    except BaseException as e:  # raised by _check
        _failure = e
        return None


@_RELEASE
def _release(_, memory, __):
    if _host.pop(memory, None) is None:
        torch.cuda.caching_allocator_delete(memory)


class _Room:
    """The most that any frame needed, and the frames whose needs are known."""

    def __init__(self):
        self.entries, self.groups, self.known = 0, 0, set()


class _Renderer:
    """A renderer of a device, a stream and settings, and its unused frames: a frame's memory
    belongs to one stream, what frames need does not."""

    made, rooms = {}, {}

    def __init__(self, room, accuracy, antialias, dilation):
        options = _Options(accuracy=accuracy, antialias=antialias, dilation=dilation,
                           allocate=_allocate, release=_release)
        self.handle = _POINTER()
        _check(_load().rye_device_renderer_create(ctypes.byref(options), ctypes.byref(self.handle)))
        self.free, self.room = [], room

    @classmethod
    def of(cls, device, stream, *settings):
        key = (device, stream, *settings)
        if key not in cls.made:
            room = cls.rooms.setdefault((device, *settings), _Room())
            cls.made[key] = cls(room, *settings)
        return cls.made[key]


class _Frame:
    """A frame, which goes back to its renderer when nobody needs it."""

    def __init__(self, renderer, captured):
        self.renderer = renderer
        self.captured = captured  # in a CUDA graph, whose memory it has
        if renderer.free and not captured:
            self.handle = renderer.free.pop()
        else:
            self.handle = _POINTER()
            _check(_library.rye_device_frame_create(renderer.handle, ctypes.byref(self.handle)))
        # Twice what was ever needed, so that a frame that was not waited for fits.
        _check(_library.rye_device_frame_room(self.handle, 2 * renderer.room.entries,
                                              2 * renderer.room.groups))

    def __del__(self):
        if getattr(self, "handle", None) and self.captured:
            _library.rye_device_frame_destroy(self.handle)
        elif getattr(self, "handle", None):
            self.renderer.free.append(self.handle)

    def cost(self, wait=True):
        """What the frame took; fits is None if that is not known yet."""
        cost = _Cost()
        _check(_library.rye_device_finish(self.handle, int(wait), ctypes.byref(cost)))
        if cost.fits >= 0:
            room = self.renderer.room
            room.entries = max(room.entries, cost.entries)
            room.groups = max(room.groups, cost.groups)
        return {"fits": None if cost.fits < 0 else bool(cost.fits), "entries": cost.entries,
                "groups": cost.groups, "skipped": cost.skipped, "bytes": cost.bytes}


# ---- drawing ---------------------------------------------------------------------------------

_ACCURACY = {"balanced": 0, "fast": 1, "tight": 2, "3dgs": 3}
_ANTIALIAS = {"classic": 0, "antialiased": 1}


class _Call:
    """What one call draws, beside its tensors."""

    def __init__(self, renderer, stream, cameras, degree, per_camera, gradient, wait):
        self.renderer, self.stream, self.cameras = renderer, stream, cameras
        self.degree, self.per_camera = degree, per_camera
        self.gradient, self.wait = gradient, wait
        self.frames = []

    def cloud(self, means, quats, scales, opacities, colors, camera):
        """The cloud as a camera sees it, and where its colours are."""
        made = _Cloud(count=means.shape[0], mean=means.data_ptr(), rotation=quats.data_ptr(),
                      scale=scales.data_ptr(), opacity=opacities.data_ptr())
        if self.degree is not None:
            made.channels, made.harmonics = 3, colors.data_ptr()
            made.bases, made.degree = colors.shape[1], self.degree
        else:
            made.channels = colors.shape[-1]
            made.feature = (colors[camera] if self.per_camera else colors).data_ptr()
        return made


class _Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx, means, quats, scales, opacities, colors, backgrounds, call):
        first = call.cameras[0]
        channels = 3 if call.degree is not None else colors.shape[-1]
        shape = (len(call.cameras), first.height, first.width)
        images = means.new_empty((*shape, channels))
        alphas = means.new_empty((*shape, 1))
        capturing = means.is_cuda and torch.cuda.is_current_stream_capturing()
        known = call.renderer.room.known
        if len(known) > 10000:
            known.clear()
        for c, camera in enumerate(call.cameras):
            frame = _Frame(call.renderer, capturing)
            key = (means.shape[0], channels, call.gradient, bytes(camera))
            cloud = call.cloud(means, quats, scales, opacities, colors, c)
            image = _Image(feature=images[c].data_ptr(), alpha=alphas[c].data_ptr())
            background = None if backgrounds is None else backgrounds[c].data_ptr()
            # A frame for a gradient is looked at in backward, when it is done anyway.
            wait = call.wait
            if wait is None:
                wait = not (call.gradient and key in known)
            while True:
                _check(_library.rye_device_draw(frame.handle, ctypes.byref(cloud),
                                                ctypes.byref(camera), background,
                                                ctypes.byref(image), int(call.gradient),
                                                call.stream))
                if capturing or not wait or frame.cost()["fits"]:
                    break
            if wait and not capturing:
                known.add(key)
            frame.key = key
            call.frames.append(frame)
        if call.gradient:
            ctx.save_for_backward(means, quats, scales, opacities, colors, alphas)
            ctx.call = call
        return images, alphas

    @staticmethod
    def backward(ctx, g_images, g_alphas):
        means, quats, scales, opacities, colors, _ = ctx.saved_tensors
        call = ctx.call
        g_images, g_alphas = g_images.contiguous(), g_alphas.contiguous()
        capturing = means.is_cuda and torch.cuda.is_current_stream_capturing()
        wanted = ctx.needs_input_grad
        total = [None] * 6
        if wanted[4] and call.per_camera:
            total[4] = torch.empty_like(colors)
        if wanted[5]:
            total[5] = means.new_empty((len(call.cameras), g_images.shape[-1]))
        names = ("mean", "rotation", "scale", "opacity")
        for c, frame in enumerate(call.frames):
            if call.wait is None and not capturing and not frame.cost()["fits"]:
                call.renderer.room.known.discard(frame.key)  # the next call waits
                raise DidNotFit(f"rasterize: a frame of {means.shape[0]} Gaussians did not fit, so "
                                "its pixels were NaN; there is room now, draw it again")
            own = [torch.empty_like(t) if wanted[k] else None
                   for k, t in enumerate((means, quats, scales, opacities))]
            out = _CloudGradient(**{name: t.data_ptr()
                                    for name, t in zip(names, own) if t is not None})
            if wanted[4]:
                own.append(total[4][c] if call.per_camera else torch.empty_like(colors))
                name = "feature" if call.degree is None else "harmonics"
                setattr(out, name, own[4].data_ptr())
            if wanted[5]:
                out.background = total[5][c].data_ptr()
            cloud = call.cloud(means, quats, scales, opacities, colors, c)
            image = _Image(feature=g_images[c].data_ptr(), alpha=g_alphas[c].data_ptr())
            _check(_library.rye_device_gradient(frame.handle, ctypes.byref(cloud),
                                                ctypes.byref(image), ctypes.byref(out)))
            for k in range(4 if call.per_camera else len(own)):
                if own[k] is not None:
                    total[k] = own[k] if total[k] is None else total[k].add_(own[k])
        return (*total, None)


def _expect(name, tensor, *shapes, device=None):
    if not isinstance(tensor, torch.Tensor) or tensor.dtype != torch.float32:
        got = getattr(tensor, "dtype", type(tensor).__name__)
        raise TypeError(f"rasterize: {name}: got {got}, expected a tensor of float32")
    if tuple(tensor.shape) not in shapes:
        text = " or ".join(str(list(s)) for s in shapes)
        raise ValueError(f"rasterize: {name}: got the shape {list(tensor.shape)}, expected {text}")
    if device is not None and tensor.device != device:
        raise ValueError(f"rasterize: {name}: is on {tensor.device}, expected on {device}")
    return tensor.contiguous()


def _cameras(viewmats, Ks, width, height, near_plane):
    """Cameras by value. What is on the device is waited for, so keep cameras on the host."""
    if viewmats.requires_grad or Ks.requires_grad:
        raise NotImplementedError("rasterize: there is no gradient of viewmats and Ks")
    made = []
    for view, k in zip(viewmats.detach().cpu().tolist(), Ks.detach().cpu().tolist()):
        if k[0][1] != 0 or k[1][0] != 0 or k[2] != [0, 0, 1]:
            raise ValueError(f"rasterize: Ks: got {k}, expected no skew and a last row 0 0 1")
        made.append(_Camera(width=width, height=height, fx=k[0][0], fy=k[1][1], cx=k[0][2],
                            cy=k[1][2], near_depth=near_plane,
                            camera_from_world=(_FLOAT * 16)(*sum(view, []))))
    return made


def rasterize(means, quats, scales, opacities, colors, viewmats, Ks, width, height, *,
              near_plane=0.01, eps2d=0.3, sh_degree=None, backgrounds=None, render_mode="RGB",
              rasterize_mode="classic", accuracy="balanced", wait=None):
    """Draws N Gaussians by C cameras. Returns (images [C, H, W, D], alphas [C, H, W, 1], info).

    means      [N, 3], world units
    quats      [N, 4], (w, x, y, z), of any norm but 0
    scales     [N, 3], standard deviations, world units
    opacities  [N], in 0..1
    colors     [N, D] or [C, N, D]; with sh_degree harmonics [N, K, 3], K >= (sh_degree + 1)^2
    viewmats   [C, 4, 4], camera from world; x right, y down, z forward. On the host, or waited for
    Ks         [C, 3, 3], pixels
    near_plane     smallest depth that is drawn
    eps2d          variance added on the screen, pixels squared
    backgrounds    [C, D], or None for zeros
    render_mode    "RGB", "D", "ED", "RGB+D", "RGB+ED": with the sum of weights times depth as the
                   last channel; E: divided by alpha
    rasterize_mode "classic", or "antialiased": opacities that keep the sum over pixels
    accuracy       "balanced", "fast", "tight", or "3dgs", the rules of the first implementation
    wait           How much memory a frame needs is known when it is drawn. None: waits for frames
                   without gradient, and for the first one of a camera and a number of Gaussians;
                   otherwise gives twice the room that any frame needed, looks in backward, and
                   raises DidNotFit. True: waits here, always. False, and in a CUDA graph: never;
                   a frame that does not fit is NaN, which info["frames"][c].cost() says.
    """
    _load()
    device, n, c = means.device, means.shape[0], viewmats.shape[0]
    if device.type != ("cpu" if _library.rye_device_is_host() else "cuda"):
        raise ValueError(f"rasterize: means: is on {device}, expected on a CUDA device")
    means = _expect("means", means, (n, 3))
    quats = _expect("quats", quats, (n, 4), device=device)
    scales = _expect("scales", scales, (n, 3), device=device)
    opacities = _expect("opacities", opacities, (n,), device=device)
    _expect("viewmats", viewmats, (c, 4, 4))
    _expect("Ks", Ks, (c, 3, 3))
    if render_mode not in ("RGB", "D", "ED", "RGB+D", "RGB+ED"):
        raise ValueError(f"rasterize: render_mode: got {render_mode!r}")
    if accuracy not in _ACCURACY:
        raise ValueError(f"rasterize: accuracy: got {accuracy!r}, expected {list(_ACCURACY)}")
    if rasterize_mode not in _ANTIALIAS:
        raise ValueError(f"rasterize: rasterize_mode: got {rasterize_mode!r}, expected "
                         f"{list(_ANTIALIAS)}")
    if render_mode == "RGB" or "+" in render_mode:
        if sh_degree is not None:
            k = colors.shape[1] if colors.dim() == 3 else 0
            colors = _expect("colors", colors, (n, max(k, (sh_degree + 1) ** 2), 3), device=device)
        else:
            d = colors.shape[-1]
            colors = _expect("colors", colors, (n, d), (c, n, d), device=device)
    if backgrounds is not None:
        d = backgrounds.shape[-1]
        backgrounds = _expect("backgrounds", backgrounds, (c, d), device=device)

    cameras = _cameras(viewmats, Ks, width, height, near_plane)
    here = torch.cuda.device(device) if means.is_cuda else contextlib.nullcontext()
    with here:
        stream = torch.cuda.current_stream(device).cuda_stream if means.is_cuda else 0
        renderer = _Renderer.of(device, stream, _ACCURACY[accuracy], _ANTIALIAS[rasterize_mode],
                                eps2d if eps2d > 0 else -1.0)

        def draw(colors, backgrounds, degree):
            tensors = [means, quats, scales, opacities, colors, backgrounds]
            gradient = torch.is_grad_enabled() and any(
                t is not None and t.requires_grad for t in tensors)
            call = _Call(renderer, stream, cameras, degree, degree is None and colors.dim() == 3,
                         gradient, wait)
            images, alphas = _Rasterize.apply(*tensors, call)
            return images, alphas, call.frames

        if render_mode == "RGB":
            images, alphas, frames = draw(colors, backgrounds, sh_degree)
            return images, alphas, {"frames": frames}
        rows = viewmats[:, 2].to(device)
        depths = (rows[:, None, :3] * means[None]).sum(-1, keepdim=True) + rows[:, None, 3:]
        none = None if backgrounds is None else backgrounds.new_zeros((c, 1))
        if render_mode in ("D", "ED"):
            images, alphas, frames = draw(depths.contiguous(), None, None)
        elif sh_degree is not None:
            images, alphas, frames = draw(colors, backgrounds, sh_degree)
            depth, _, more = draw(depths.contiguous(), None, None)
            images, frames = torch.cat([images, depth], -1), frames + more
        else:
            every = colors if colors.dim() == 3 else colors[None].expand(c, -1, -1)
            wide = None if none is None else torch.cat([backgrounds, none], -1)
            images, alphas, frames = draw(torch.cat([every, depths], -1).contiguous(), wide, None)
        if "ED" in render_mode:
            expected = images[..., -1:] / alphas.clamp(min=1e-10)
            images = torch.cat([images[..., :-1], expected], -1)
        return images, alphas, {"frames": frames}
