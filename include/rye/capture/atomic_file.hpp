// SPDX-License-Identifier: Apache-2.0
/// rye/capture/atomic_file.hpp: a file is replaced by a complete one or not at all.
/// The new bytes go to a temporary file in the same folder; commit() makes them durable (fsync),
/// renames over the target, and makes the rename durable (fsync of the folder). Without commit()
/// the target is untouched and the temporary file is removed. A durable file survives a power cut
/// and costs milliseconds; one that can be made again need only be atomic. POSIX.
#pragma once

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <rye/capture/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye {

enum class Durability { durable, atomic_only };

class AtomicFile {
public:
    explicit AtomicFile(const std::filesystem::path& path) : target_(resolved(path)) {
        std::error_code ignored;
        if (std::filesystem::is_directory(target_, ignored)) fail("is a folder, not a file");
        // Names are tried in turn so that two writers never share one.
        for (int i = 0; descriptor_ < 0; ++i) {
            temporary_ = target_;
            temporary_ += ".tmp-" + std::to_string(::getpid()) + "-" + std::to_string(i);
            descriptor_ = ::open(temporary_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
            if (descriptor_ < 0 && errno != EEXIST) {
                temporary_.clear();
                fail_errno("cannot be written");
            }
        }
        // A replaced file keeps its permissions.
        struct stat old {};
        if (::stat(target_.c_str(), &old) == 0 && ::fchmod(descriptor_, old.st_mode & 07777U) != 0)
            discard_and_fail("its permissions cannot be kept");
    }
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;
    ~AtomicFile() { discard(); }

    void write(ByteSpan bytes) {
        while (!bytes.empty()) {
            const ::ssize_t n = ::write(descriptor_, bytes.data(), bytes.size());
            if (n < 0 && errno == EINTR) continue;
            if (n < 0) discard_and_fail("cannot be written");
            bytes = bytes.subspan(static_cast<std::size_t>(n));
        }
    }

    void commit(Durability durability = Durability::durable) {
        const bool durable = durability == Durability::durable;
        if (durable && ::fsync(descriptor_) != 0) discard_and_fail("cannot be made durable");
        const int closed = ::close(std::exchange(descriptor_, -1));
        if (closed != 0) discard_and_fail("cannot be closed");
        if (::rename(temporary_.c_str(), target_.c_str()) != 0)
            discard_and_fail("cannot be replaced");
        temporary_.clear();
        if (durable) sync_folder();
    }

private:
    /// A link stays a link: what it points to is replaced.
    static std::filesystem::path resolved(const std::filesystem::path& path) {
        std::error_code status;
        if (!std::filesystem::is_symlink(path, status)) return path;
        const std::filesystem::path target = std::filesystem::weakly_canonical(path, status);
        return status ? path : target;
    }
    void sync_folder() const {
        const std::filesystem::path parent = target_.parent_path();
        const std::string folder = parent.empty() ? "." : parent.string();
        const int descriptor = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
        if (descriptor < 0) return;  // a folder that may be written but not read
        const int synced = ::fsync(descriptor);
        const int reason = errno;
        ::close(descriptor);
        // Some file systems know no fsync of a folder; the file itself is complete either way.
        if (synced != 0 && reason != EINVAL && reason != ENOTSUP) {
            errno = reason;
            fail_errno("was replaced, but its folder cannot be made durable");
        }
    }
    void discard() {
        if (descriptor_ >= 0) ::close(std::exchange(descriptor_, -1));
        if (!temporary_.empty()) ::unlink(temporary_.c_str());
        temporary_.clear();
    }
    [[noreturn]] void fail(const std::string& sentence) const {
        throw Error(target_.string() + ": " + sentence);
    }
    [[noreturn]] void fail_errno(const std::string& sentence) const {
        fail(sentence + ": " + std::strerror(errno));
    }
    [[noreturn]] void discard_and_fail(const std::string& sentence) {
        const int reason = errno;
        discard();
        errno = reason;
        fail_errno(sentence + " (the old file is untouched)");
    }

    std::filesystem::path target_;
    std::filesystem::path temporary_;  // empty when there is none to remove
    int descriptor_ = -1;
};

inline void write_atomic(const std::filesystem::path& path, ByteSpan bytes,
                         Durability durability = Durability::durable) {
    AtomicFile file(path);
    file.write(bytes);
    file.commit(durability);
}

} // namespace rye
