#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# torch.sh LIBRARY: tests rye_torch.py with a library rye_device, where a Python has PyTorch.
set -u
here=$(cd "$(dirname "$0")" && pwd)
for python in python3 /usr/bin/python3; do
    if "$python" -c 'import torch' 2> /dev/null; then
        exec env RYE_DEVICE_LIBRARY="$1" "$python" "$here/test_rye_torch.py"
    fi
done
echo "torch: skipped, no Python has PyTorch (Debian: python3-torch)"
exit 77
