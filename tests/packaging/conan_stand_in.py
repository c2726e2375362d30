# SPDX-License-Identifier: Apache-2.0
"""conan_stand_in.py RECIPE WORK VERSION: runs the methods of a Conan recipe in Conan's order, with
small functions in the place of Conan's own, and checks what it states."""
import fnmatch
import importlib.util
import os
import shutil
import sys
import types

recipe, work, version = sys.argv[1:]


def copy(recipe, pattern, src, dst):
    src = os.path.realpath(src)
    for folder, _, names in os.walk(src):
        for name in names:
            path = os.path.join(folder, name)
            if fnmatch.fnmatch(os.path.relpath(path, src), pattern):
                to = os.path.join(dst, os.path.relpath(path, src))
                os.makedirs(os.path.dirname(to), exist_ok=True)
                shutil.copy(path, to)


conan, tools, files = (types.ModuleType(n) for n in ("conan", "conan.tools", "conan.tools.files"))
conan.ConanFile = type("ConanFile", (), {"requires": lambda self, ref, **_: self.needs.append(ref)})
files.copy = copy
files.load = lambda recipe, path: open(path).read()
sys.modules.update({m.__name__: m for m in (conan, tools, files)})

spec = importlib.util.spec_from_file_location("conanfile", recipe)
module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
r = module.Rye()
r.needs = []
r.recipe_folder = os.path.dirname(os.path.abspath(recipe))
r.export_sources_folder = r.source_folder = os.path.join(work, "source")
r.package_folder = os.path.join(work, "package")
r.cpp_info = types.SimpleNamespace()
r.info = types.SimpleNamespace(clear=lambda: None)
r.set_version()
assert r.version == version, f"version {r.version}, expected {version}"
r.export_sources()
r.requirements()
assert [n.split("/")[0] for n in r.needs] == ["eigen", "xsimd"], r.needs
r.package()
r.package_id()
r.package_info()
assert os.path.isfile(os.path.join(r.package_folder, "licenses", "LICENSE"))
