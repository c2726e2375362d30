# SPDX-License-Identifier: Apache-2.0
# aarch64.cmake: a toolchain file of CMake's: Debian's cross compiler, headers and libraries from
# RYE_SYSROOT (made by portability.sh), programs run by qemu-user.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES RYE_SYSROOT RYE_CROSS_COMPILER)
set(CMAKE_CXX_COMPILER ${RYE_CROSS_COMPILER})
set(CMAKE_CXX_COMPILER_TARGET aarch64-linux-gnu)
set(CMAKE_LIBRARY_ARCHITECTURE aarch64-linux-gnu)
set(CMAKE_FIND_ROOT_PATH ${RYE_SYSROOT})
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
set(CMAKE_CROSSCOMPILING_EMULATOR qemu-aarch64;-L;/usr/aarch64-linux-gnu;-E
    LD_LIBRARY_PATH=${RYE_SYSROOT}/usr/lib/aarch64-linux-gnu:${RYE_SYSROOT}/lib/aarch64-linux-gnu)
# zlib, which libpng needs, lies in the other folder of libraries.
set(CMAKE_EXE_LINKER_FLAGS_INIT -Wl,-rpath-link,${RYE_SYSROOT}/lib/aarch64-linux-gnu)
# Headers of one processor, such as libjpeg's jconfig.h.
set(CMAKE_CXX_STANDARD_INCLUDE_DIRECTORIES ${RYE_SYSROOT}/usr/include/${CMAKE_LIBRARY_ARCHITECTURE})
