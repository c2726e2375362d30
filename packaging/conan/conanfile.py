# SPDX-License-Identifier: Apache-2.0
"""Conan 2 recipe of the headers, of the checkout that it lies in:

    conan create CHECKOUT/packaging/conan

Tried: its methods, with Conan's classes and functions replaced by small ones that copy files
(tests/packaging/packages.sh). Not tried: Conan itself, which is neither a Debian nor an npm package.
"""
import os
import re

from conan import ConanFile
from conan.tools.files import copy, load


class Rye(ConanFile):
    name = "rye"
    license = "Apache-2.0"
    description = "C++20 toolkit for Gaussian splatting and head avatars whose eyes can be turned"
    package_type = "header-library"
    settings = "os", "arch", "compiler", "build_type"
    no_copy_source = True

    def _checkout(self):
        return os.path.join(self.recipe_folder, "..", "..")

    def set_version(self):
        text = load(self, os.path.join(self._checkout(), "include/rye/core/config.hpp"))
        self.version = ".".join(re.findall(r"#define RYE_VERSION_[A-Z]+ ([0-9]+)", text))

    def export_sources(self):
        for pattern in ("LICENSE", "include/*"):
            copy(self, pattern, self._checkout(), self.export_sources_folder)

    def requirements(self):
        self.requires("eigen/[>=3.4.0]", transitive_headers=True)
        self.requires("xsimd/[>=8.1.0]", transitive_headers=True)

    def package(self):
        copy(self, "*.hpp", os.path.join(self.source_folder, "include"),
             os.path.join(self.package_folder, "include"))
        copy(self, "LICENSE", self.source_folder, os.path.join(self.package_folder, "licenses"))

    def package_id(self):
        self.info.clear()

    def package_info(self):
        self.cpp_info.defines = ["EIGEN_DONT_PARALLELIZE", "EIGEN_STACK_ALLOCATION_LIMIT=16384"]
        self.cpp_info.bindirs = []
        self.cpp_info.libdirs = []
