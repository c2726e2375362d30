// SPDX-License-Identifier: Apache-2.0
/// commands/commands.hpp: the subcommands of `rye`; each function adds one to the program, and
/// add_commands all of them.
#pragma once

namespace CLI {
class App;
}

namespace rye::trainer {

void add_commands(CLI::App& app);

void add_capture(CLI::App& app);
void add_pack(CLI::App& app);
void add_import(CLI::App& app);
void add_avatar(CLI::App& app);
void add_flaw(CLI::App& app);
void add_info(CLI::App& app);
void add_train(CLI::App& app);
void add_refine(CLI::App& app);
void add_redirect(CLI::App& app);
void add_evaluate(CLI::App& app);
void add_compare(CLI::App& app);
void add_export(CLI::App& app);
void add_render(CLI::App& app);
void add_drivers(CLI::App& app);
void add_view(CLI::App& app);
void add_completion(CLI::App& app);
void add_manual(CLI::App& app);

} // namespace rye::trainer
