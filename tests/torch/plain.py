# SPDX-License-Identifier: Apache-2.0
"""plain.py: every Gaussian at every pixel in PyTorch, in double precision: what rye_torch.py is
compared with. Source: Zwicker et al., "EWA Splatting", 2002, equations 8 and 26; Kerbl et al., "3D
Gaussian Splatting", 2023, equations 3 and 6."""

import torch


def rotations(quats):
    w, x, y, z = torch.nn.functional.normalize(quats, dim=-1).unbind(-1)
    return torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1).reshape(-1, 3, 3)


def harmonic_colors(coefficients, degree, means, eye):
    """Colours of harmonics [N, K, 3] of a degree up to 2."""
    x, y, z = torch.nn.functional.normalize(means - eye, dim=-1).unbind(-1)
    c = [0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005,
         0.5462742152960396]
    basis = [c[0] + 0 * x, -c[1] * y, c[1] * z, -c[1] * x, c[2] * x * y, -c[2] * y * z,
             c[3] * (2 * z * z - x * x - y * y), -c[2] * x * z, c[4] * (x * x - y * y)]
    basis = torch.stack(basis[:(degree + 1) ** 2], -1)
    return (0.5 + torch.einsum("nk,nkc->nc", basis, coefficients[:, :basis.shape[1]])).clamp(min=0)


def project(means, quats, scales, opacities, view, k, eps2d=0.3, antialiased=False):
    """Centres on the screen, inverse covariances there, opacities and depths."""
    at = means @ view[:3, :3].T + view[:3, 3]
    x, y, z = at.unbind(-1)
    fx, fy, cx, cy = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * x / z ** 2, zero, fy / z, -fy * y / z ** 2],
                           -1).reshape(-1, 2, 3)
    m = jacobian @ view[:3, :3] @ rotations(quats) * scales[:, None, :]
    covariance = m @ m.transpose(1, 2)
    wide = covariance + eps2d * torch.eye(2, dtype=means.dtype, device=means.device)
    o = opacities
    if antialiased:
        o = o * (torch.det(covariance).clamp(min=0) / torch.det(wide)).clamp(min=1e-30).sqrt()
    centres = torch.stack([fx * x / z + cx, fy * y / z + cy], -1)
    return centres, torch.linalg.inv(wide), o, z


def blend(projected, colors, pixels, background=None):
    """Colours [..., D] and alphas [..., 1] at points of the screen [..., 2]."""
    centres, inverse, o, z = projected
    order = torch.argsort(z)
    d = pixels[..., None, :] - centres[order]
    q = torch.einsum("...ni,nij,...nj->...n", d, inverse[order], d)
    alpha = o[order] * torch.exp(-0.5 * q)
    through = torch.cumprod(1 - alpha, -1)
    before = torch.cat([torch.ones_like(through[..., :1]), through[..., :-1]], -1)
    picture = (before * alpha) @ colors[order]
    if background is not None:
        picture = picture + through[..., -1:] * background
    return picture, 1 - through[..., -1:]


def draw(means, quats, scales, opacities, colors, view, k, width, height, background=None,
         **how):
    """One picture [H, W, D] and its alpha [H, W, 1], without any shortcut."""
    u, v = torch.meshgrid(torch.arange(width, dtype=means.dtype) + 0.5,
                          torch.arange(height, dtype=means.dtype) + 0.5, indexing="xy")
    return blend(project(means, quats, scales, opacities, view, k, **how), colors,
                 torch.stack([u, v], -1), background)
