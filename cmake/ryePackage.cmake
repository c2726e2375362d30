# SPDX-License-Identifier: Apache-2.0
# ryePackage.cmake: Debian packages by `cpack -G DEB` in the build folder: librye-dev (the headers,
# for every processor), and where they are built rye (the program) and librye-c-dev (for C). Configure
# with -DRYE_NATIVE=OFF for a program that runs on other machines; one that does not has "native" in
# the name of its file.
set(RYE_MAINTAINER "The maintainers of rye" CACHE STRING
    "Who answers for the packages: \"Name <address>\", as Debian wants it")
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME rye)
set(CPACK_PACKAGE_VENDOR "")
set(CPACK_PACKAGE_CONTACT "${RYE_MAINTAINER}")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "${PROJECT_DESCRIPTION}")
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_COMPONENTS_ALL Unspecified)
if(RYE_BUILD_PROGRAMS)
  list(APPEND CPACK_COMPONENTS_ALL programs)
endif()
if(RYE_BUILD_C)
  list(APPEND CPACK_COMPONENTS_ALL c)
endif()
set(CPACK_COMPONENTS_GROUPING IGNORE)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION graphics)

set(CPACK_COMPONENT_UNSPECIFIED_DESCRIPTION
    "Headers of a C++20 toolkit for Gaussian splatting and head avatars whose eyes can be turned.")
set(CPACK_DEBIAN_UNSPECIFIED_PACKAGE_NAME librye-dev)
set(CPACK_DEBIAN_UNSPECIFIED_PACKAGE_ARCHITECTURE all)
set(CPACK_DEBIAN_UNSPECIFIED_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_UNSPECIFIED_PACKAGE_DEPENDS
    "libeigen3-dev (>= ${rye_least_Eigen3}), libxsimd-dev (>= ${rye_least_xsimd})")

# Packages state the shared libraries of their programs where Debian's tools for it are.
find_program(RYE_SHLIBDEPS dpkg-shlibdeps)
find_program(RYE_FILE file)
mark_as_advanced(RYE_SHLIBDEPS RYE_FILE)
set(shlibdeps OFF)
if(RYE_SHLIBDEPS AND RYE_FILE)
  set(shlibdeps ON)
else()
  message(STATUS "rye: packages name no shared libraries (that takes Debian's dpkg-dev and file)")
endif()

set(CPACK_COMPONENT_PROGRAMS_DESCRIPTION
    "Trainer of head avatars whose eyes can be turned: captures in, images and splat files out.")
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_NAME rye)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SHLIBDEPS ${shlibdeps})

set(CPACK_COMPONENT_C_DESCRIPTION
    "The interface for C of rye: draws Gaussians and head avatars whose eyes can be turned.")
set(CPACK_DEBIAN_C_PACKAGE_NAME librye-c-dev)
set(CPACK_DEBIAN_C_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_C_PACKAGE_SHLIBDEPS ${shlibdeps})
# librye-dev has not had its header since this version.
set(CPACK_DEBIAN_C_PACKAGE_BREAKS "librye-dev (<< ${PROJECT_VERSION})")
set(CPACK_DEBIAN_C_PACKAGE_REPLACES "librye-dev (<< ${PROJECT_VERSION})")

if(RYE_NATIVE)
  execute_process(COMMAND dpkg --print-architecture OUTPUT_VARIABLE architecture
                  OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET)
  set(CPACK_DEBIAN_PROGRAMS_FILE_NAME rye_${PROJECT_VERSION}_native_${architecture}.deb)
  set(CPACK_DEBIAN_C_FILE_NAME librye-c-dev_${PROJECT_VERSION}_native_${architecture}.deb)
endif()

# What is not built has no package: read by cpack before each kind of package.
get_property(packaged GLOBAL PROPERTY rye_packaged)
set(CPACK_PROJECT_CONFIG_FILE ${PROJECT_BINARY_DIR}/ryePackaged.cmake)
if(NOT CMAKE_CONFIGURATION_TYPES)
  file(GENERATE OUTPUT ${CPACK_PROJECT_CONFIG_FILE} CONTENT "
macro(rye_package_if_built component)
  foreach(file \${ARGN})
    if(NOT EXISTS \"\${file}\")
      message(STATUS \"rye: \${file} is not built, so the component \${component} has no package\")
      list(REMOVE_ITEM CPACK_COMPONENTS_ALL \${component})
      break()
    endif()
  endforeach()
endmacro()
${packaged}")
else()
  unset(CPACK_PROJECT_CONFIG_FILE)
endif()
include(CPack)
