# SPDX-License-Identifier: Apache-2.0
# An overlay port of the checkout that it lies in:
#     vcpkg install rye --overlay-ports=CHECKOUT/packaging/vcpkg
# Tried: its steps, with vcpkg's functions replaced by the CMake commands that they run
# (tests/packaging/packages.sh, which also compares the version with rye's). Not tried: vcpkg itself,
# which is neither a Debian nor an npm package.
get_filename_component(SOURCE_PATH "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)
set(VCPKG_BUILD_TYPE release) # only headers
vcpkg_cmake_configure(
    SOURCE_PATH "${SOURCE_PATH}"
    OPTIONS -DRYE_BUILD_PROGRAMS=OFF -DRYE_BUILD_EXAMPLES=OFF -DRYE_BUILD_TESTS=OFF
            -DRYE_BUILD_BENCHMARKS=OFF -DRYE_INSTALL=ON)
vcpkg_cmake_install()
vcpkg_cmake_config_fixup(CONFIG_PATH share/cmake/rye)
vcpkg_fixup_pkgconfig()
vcpkg_install_copyright(FILE_LIST "${SOURCE_PATH}/LICENSE")
