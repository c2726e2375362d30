# SPDX-License-Identifier: Apache-2.0
# windows.cmake: a toolchain file of CMake's: Debian's mingw-w64 with POSIX threads; headers and
# libraries from RYE_SYSROOT (made by windows.sh); programs with all libraries inside.
set(CMAKE_SYSTEM_NAME Windows)
set(CMAKE_SYSTEM_PROCESSOR x86_64)
list(APPEND CMAKE_TRY_COMPILE_PLATFORM_VARIABLES RYE_SYSROOT)
set(CMAKE_C_COMPILER x86_64-w64-mingw32-gcc-posix)
set(CMAKE_CXX_COMPILER x86_64-w64-mingw32-g++-posix)
set(CMAKE_RC_COMPILER x86_64-w64-mingw32-windres)
set(CMAKE_FIND_ROOT_PATH ${RYE_SYSROOT} /usr/x86_64-w64-mingw32)
set(CMAKE_FIND_ROOT_PATH_MODE_PROGRAM NEVER)
set(CMAKE_FIND_ROOT_PATH_MODE_LIBRARY ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_INCLUDE ONLY)
set(CMAKE_FIND_ROOT_PATH_MODE_PACKAGE ONLY)
# Not libz.dll.a beside it.
set(ZLIB_LIBRARY /usr/x86_64-w64-mingw32/lib/libz.a CACHE FILEPATH "zlib")
set(CMAKE_EXE_LINKER_FLAGS_INIT -static)
file(GLOB xsimd_DIR ${RYE_SYSROOT}/usr/lib/*/cmake/xsimd) # Debian's folder is of a processor
