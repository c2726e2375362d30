#!/bin/sh
# SPDX-License-Identifier: Apache-2.0
# install_dependencies.sh: sees what building rye needs and is not there, and installs that with
# apt, as root or through sudo. Does nothing when everything is there. Where there is no apt, or no
# right to use it, it names what is missing.
set -eu

cxx=${CXX:-c++}

has_command() { command -v "$1" > /dev/null 2>&1; }
has_header() {
    printf '#include <%s>\n' "$1" |
        $cxx -std=c++20 -I/usr/include/eigen3 -E -x c++ - > /dev/null 2>&1
}
missing() {
    has_command "$cxx" || echo g++
    has_command cmake || echo cmake
    has_command ninja || has_command make || echo ninja-build
    has_header Eigen/Core || echo libeigen3-dev
    has_header xsimd/xsimd.hpp || echo libxsimd-dev
    has_header CLI/CLI.hpp || echo libcli11-dev
    has_header nlohmann/json.hpp || echo nlohmann-json3-dev
    has_header jpeglib.h || echo libjpeg-dev
    has_header png.h || echo libpng-dev
    has_header zlib.h || echo zlib1g-dev
    has_header zstd.h || echo libzstd-dev
    has_header hdf5/serial/hdf5.h || has_header hdf5.h || echo libhdf5-dev
    has_header asio.hpp || echo libasio-dev
    has_header doctest/doctest.h || echo doctest-dev
    has_header benchmark/benchmark.h || echo libbenchmark-dev
    has_header glm/glm.hpp || echo libglm-dev
    has_command pkg-config || echo pkg-config
}

packages=$(missing | tr '\n' ' ')
if [ -z "$packages" ]; then
    echo "install_dependencies: everything is there"
    exit 0
fi

root=
if [ "$(id -u)" != 0 ]; then
    root=sudo
fi
if ! has_command apt-get || { [ -n "$root" ] && ! has_command sudo; }; then
    echo "install_dependencies: missing, by the names of their Debian packages: $packages" >&2
    echo "install_dependencies: install them, or run this as root on a system with apt" >&2
    exit 1
fi

echo "install_dependencies: installing $packages"
$root apt-get update
# shellcheck disable=SC2086 # a list of packages
$root env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $packages

packages=$(missing | tr '\n' ' ')
if [ -n "$packages" ]; then
    echo "install_dependencies: installed, but still not found: $packages" >&2
    exit 1
fi
