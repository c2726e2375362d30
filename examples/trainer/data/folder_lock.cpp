// SPDX-License-Identifier: Apache-2.0
#include "data/folder_lock.hpp"

#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <rye/core/error.hpp>

namespace rye::trainer {
namespace {

/// Returns words such as "rye train, process 12 on HOST since 2026-01-02T03:04:05Z".
std::string words_of(const std::string& holder) {
    std::array<char, 256> host{};
    if (::gethostname(host.data(), host.size() - 1) != 0) host[0] = '\0';
    std::array<char, 32> since{};
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    if (::gmtime_r(&now, &utc) != nullptr)
        std::strftime(since.data(), since.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
    return holder + ", process " + std::to_string(::getpid()) + " on " + host.data() + " since " +
           since.data();
}

/// Returns the first line of the lock's file, printable.
std::string read_words(int file) {
    std::array<char, 400> text{};
    const ::ssize_t n = ::pread(file, text.data(), text.size(), 0);
    std::string words;
    for (::ssize_t i = 0; i < n && text[static_cast<std::size_t>(i)] != '\n'; ++i) {
        const char c = text[static_cast<std::size_t>(i)];
        words += c >= ' ' && c < 127 ? c : '?';
    }
    return words;
}

} // namespace

FolderLock::FolderLock(const std::filesystem::path& folder, const LockOptions& options) {
    const std::filesystem::path path = folder / "lock";
    // Not closed by exec if children are to hold it, too.
    file_ = ::open(path.c_str(), O_RDWR | O_CREAT | (options.children_too ? 0 : O_CLOEXEC), 0666);
    require(file_ >= 0, path.string(), "cannot be written: ", [&] { return std::strerror(errno); });
    const int tries = 1 + static_cast<int>(10 * options.patience); // one every 0.1 s
    for (int i = 0; ::flock(file_, LOCK_EX | LOCK_NB) != 0; ++i) {
        if (errno == EINTR) continue;
        if (errno != EWOULDBLOCK) return; // a file system without locks
        if (i + 1 >= tries) {
            const std::string words = read_words(file_);
            ::close(file_);
            throw Error(folder.string() + ": is in use by " +
                        (words.empty() ? "another process of rye" : words) +
                        "; wait until it has ended, or name another --out");
        }
        ::usleep(100000);
    }
    // The holder's words are for people: a full disk does not matter.
    const std::string words = words_of(options.holder) + "\n";
    if (::ftruncate(file_, 0) == 0 && ::pwrite(file_, words.data(), words.size(), 0) < 0) return;
}

FolderLock::~FolderLock() { ::close(file_); }

} // namespace rye::trainer
