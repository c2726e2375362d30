# SPDX-License-Identifier: Apache-2.0
# find_nvcc.sh: to be sourced; sets nvcc to $NVCC, that of the PATH, or of /usr/local/cuda. Where there
# is none, prints $not_compiled, which begins with "NAME: skipped", and ends the script with 77.
for nvcc in "${NVCC:-}" nvcc /usr/local/cuda/bin/nvcc none; do
    if [ -n "$nvcc" ] && command -v "$nvcc" > /dev/null; then break; fi
done
if [ "$nvcc" = none ]; then
    echo "$not_compiled"
    exit 77
fi
