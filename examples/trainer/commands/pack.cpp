// SPDX-License-Identifier: Apache-2.0
/// `rye pack`: makes a head model for `rye capture --model` of MakeHuman's files.
#include <iostream>
#include <memory>

#include <CLI/CLI.hpp>

#include <rye/core/error.hpp>

#include "commands/commands.hpp"
#include "commands/options.hpp"
#include "synthetic_capture/makehuman_pack.hpp"

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;

struct PackOptions {
    fs::path makehuman, out;
    bool overwrite = false, quiet = false;
};

void run(const PackOptions& o) {
    const fs::path names = o.out.parent_path() / "names.json";
    for (const fs::path& path : {o.out, names})
        require(o.overwrite || !fs::exists(path), path.string(),
                "exists already; --overwrite replaces it");
    const HeadPack pack = pack_makehuman(o.makehuman);
    write_atomic(names, as_bytes(pack.names));
    write_npz(o.out, pack.arrays);
    if (!o.quiet)
        std::cout << o.out.string() << ": " << pack.arrays.at("neutral").shape[0] << " vertices, "
                  << pack.arrays.at("expr_offset").shape[0] - 1 << " expressions, "
                  << pack.arrays.at("id_delta").shape[0] << " modes of identity\n";
}

} // namespace

void add_pack(CLI::App& app) {
    const auto o = std::make_shared<PackOptions>();
    CLI::App* c = app.add_subcommand(
        "pack", "Make a head model for `rye capture --model` of MakeHuman's base mesh and targets");
    c->add_option("--makehuman", o->makehuman, "Folder with base.obj and targets, plain or as .gz")
        ->required()
        ->check(folder_check("the folder of MakeHuman's base.obj and targets"));
    c->add_option("--out", o->out, "File to write (.npz); names.json is written beside it")
        ->required()
        ->check([](const std::string& text) {
            return text.ends_with(".npz") ? "" : "got '" + text + "', expected .npz";
        });
    c->add_flag("--overwrite", o->overwrite, "Replace files that are there");
    c->add_flag("--quiet", o->quiet, "No summary");
    c->callback([o] { run(*o); });
}

} // namespace rye::trainer
