#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Converts the weights of LPIPS (net = 'vgg') to the file that rye reads. Needs torch.

rye ships no weights. The two inputs, each with its own licence, are
  --vgg   the state dict of torchvision's vgg16 (BSD-3), for example the file that
          torchvision.models.vgg16(weights="IMAGENET1K_V1") leaves in torch's cache, and
  --lin   the linear weights of LPIPS 0.1 (BSD-2): lpips/weights/v0.1/vgg.pth of the pip package.

  python3 convert_lpips_weights.py --vgg vgg16-397923af.pth --lin vgg.pth --out lpips_vgg.safetensors

Layout: a matrix of R rows and C columns, stored column by column, is a tensor of shape (C, R).
A kernel [out, in, ky, kx] becomes out x 9 in with columns in the order ky, kx, in.
"""
import argparse
import json
import os
import struct
import zlib

# torchvision's numbering of the convolutions: ReLUs and maxima count too.
CONVOLUTIONS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)


def rye_tensors(vgg, lin):
    """{name: float32 tensor of two extents} from the two state dicts."""
    out = {}
    for i in CONVOLUTIONS:
        weight, bias = vgg[f"features.{i}.weight"], vgg[f"features.{i}.bias"]
        if tuple(weight.shape[2:]) != (3, 3) or bias.shape[0] != weight.shape[0]:
            raise SystemExit(f"features.{i}: got {tuple(weight.shape)}, expected out x in x 3 x 3")
        flat = weight.permute(2, 3, 1, 0).reshape(9 * weight.shape[1], weight.shape[0])
        out[f"features.{i}.weight"] = flat
        out[f"features.{i}.bias"] = bias.reshape(1, -1)
    for s in range(5):
        weight = lin[f"lin{s}.model.1.weight"].reshape(1, -1)
        if (weight < 0).any():
            raise SystemExit(f"lin{s}: got a negative weight, expected none")
        out[f"lin{s}.weight"] = weight
    return {name: t.detach().float().cpu().contiguous() for name, t in out.items()}


def write_safetensors(path, tensors):
    """{name: contiguous float32 or float64 CPU tensor} as one safetensors file."""
    header, blobs, offset = {}, [], 0
    for name in sorted(tensors):
        t = tensors[name]
        blob = t.numpy().tobytes()
        header[name] = {
            "dtype": {4: "F32", 8: "F64"}[t.element_size()],
            "shape": list(t.shape),
            "data_offsets": [offset, offset + len(blob)],
        }
        blobs.append(blob)
        offset += len(blob)
    # As rye's writer: a line of each array with the CRC-32 of its bytes, and the CRC-32 of the lines.
    lines = ""
    for (name, t), blob in zip(sorted(tensors.items()), blobs):
        extents = ", ".join(map(str, t.shape)) + ("," if t.dim() == 1 else "")
        lines += f"{name} {header[name]['dtype']} ({extents}) {zlib.crc32(blob)}\n"
    header["__metadata__"] = {"checksum": f"{zlib.crc32(lines.encode()):08x}"}
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    part = f"{path}.part"
    with open(part, "wb") as f:
        f.write(struct.pack("<Q", len(text)) + text)
        f.writelines(blobs)
    os.replace(part, path)


def main():
    import torch

    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--vgg", required=True, help="torchvision's vgg16 state dict (.pth)")
    parser.add_argument("--lin", required=True, help="LPIPS 0.1 linear weights, vgg.pth")
    parser.add_argument("--out", required=True, help="the file to write (.safetensors)")
    a = parser.parse_args()
    vgg, lin = (torch.load(p, map_location="cpu") for p in (a.vgg, a.lin))
    write_safetensors(a.out, rye_tensors(vgg, lin))
    print(f"wrote {a.out}")


if __name__ == "__main__":
    main()
