# SPDX-License-Identifier: Apache-2.0
"""Reads float64 safetensors into torch; exits with 77, the status of a skipped test, without it."""
import json
import struct
import sys

try:
    import torch
except ImportError:
    print("torch is not installed: skipped")
    sys.exit(77)


def read_f64(path):
    """{name: tensor}; a matrix of R rows and C columns has shape (C, R)."""
    with open(path, "rb") as f:
        (length,) = struct.unpack("<Q", f.read(8))
        header = json.loads(f.read(length))
        data = bytearray(f.read())
    out = {}
    for name, t in header.items():
        if name != "__metadata__":
            begin, end = t["data_offsets"]
            values = torch.frombuffer(data[begin:end], dtype=torch.float64)
            out[name] = values.reshape(t["shape"])
    return out


def relative_error(got, expected):
    return ((got - expected).norm() / expected.norm()).item()
