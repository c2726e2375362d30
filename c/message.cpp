// SPDX-License-Identifier: Apache-2.0
/// c/message.cpp: the message of a thread's last failure, one in each library.
#include <string>

#include "status.hpp"

namespace rye::c {
namespace {

thread_local std::string message;
thread_local const char* shown = "no call has failed";

} // namespace

rye_status fail(rye_status status, const char* text) noexcept {
    try {
        message = text;
        shown = message.c_str();
    } catch (...) {
        shown = "out of memory";
    }
    return status;
}

const char* last_message() noexcept { return shown; }

} // namespace rye::c
