// SPDX-License-Identifier: Apache-2.0
#include "commands/commands.hpp"

namespace rye::trainer {

void add_commands(CLI::App& app) {
    add_capture(app);
    add_pack(app);
    add_import(app);
    add_avatar(app);
    add_flaw(app);
    add_info(app);
    add_train(app);
    add_refine(app);
    add_redirect(app);
    add_evaluate(app);
    add_compare(app);
    add_export(app);
    add_render(app);
    add_drivers(app);
    add_view(app);
    add_completion(app);
    add_manual(app);
}

} // namespace rye::trainer
