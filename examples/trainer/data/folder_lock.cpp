// SPDX-License-Identifier: Apache-2.0
#include "data/folder_lock.hpp"

#include <chrono>
#include <thread>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Returns the first line of the words, printable.
std::string first_line(const std::string& words) {
    std::string line;
    for (const char c : words) {
        if (c == '\n') break;
        line += c >= ' ' && c < 127 ? c : '?';
    }
    return line;
}

} // namespace

FolderLock::FolderLock(const std::filesystem::path& folder, const LockOptions& options)
    : file_(folder / "lock", options.children_too) {
    const int tries = 1 + static_cast<int>(10 * options.patience); // one every 0.1 s
    for (int i = 0;; ++i) {
        const LockFile::Taking taking = file_.take();
        if (taking == LockFile::Taking::no_locks) return;
        if (taking == LockFile::Taking::done) break;
        if (i + 1 >= tries) {
            const std::string words = first_line(file_.words());
            throw Error(folder.string() + ": is in use by " +
                        (words.empty() ? "another process of rye" : words) +
                        "; wait until it has ended, or name another --out");
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
    // The holder's words are for people.
    file_.write(options.holder + ", " + process_words() + "\n");
}

} // namespace rye::trainer
