// SPDX-License-Identifier: Apache-2.0
/// rye/capture/atomic_file.hpp: atomic replacement of a file by a complete one.
/// Writes to a temporary file in the same folder, NAME.tmp-0; commit() makes it durable (fsync),
/// renames it over the target, and makes the rename durable (fsync of the folder). Without
/// commit() the target is unchanged and the temporary file is removed. Durability survives a power
/// cut and costs milliseconds; a file that can be regenerated need only be atomic. POSIX.
///
/// A killed process leaves its temporary file. A writer locks (flock) its own, and the lock ends
/// with the process; the next writer of the same target removes unlocked ones. On a file system
/// without locks they stay.
///
/// A pipe or a character device (/dev/null, /dev/stdout) cannot be replaced: it is written in place
/// immediately. Folders, block devices and sockets are rejected.
#pragma once

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <system_error>
#include <utility>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <rye/capture/bytes.hpp>
#include <rye/core/error.hpp>

namespace rye {

/// Durability of a written file: it survives a power cut, or is only replaced as a whole.
enum class Durability { durable, atomic_only };

/// File that replaces another when it is committed. Throws an Error, with the path, if the system
/// refuses.
class AtomicFile {
public:
    explicit AtomicFile(const std::filesystem::path& path) : target_(path) {
        struct stat old {};
        const bool there = ::stat(path.c_str(), &old) == 0;
        if (there && S_ISDIR(old.st_mode)) fail("is a folder, not a file");
        if (there && (S_ISFIFO(old.st_mode) || S_ISCHR(old.st_mode))) {
            descriptor_ = ::open(path.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC);
            if (descriptor_ < 0) fail_errno("cannot be written");
            return;
        }
        if (there && !S_ISREG(old.st_mode))
            fail("is neither a file nor a pipe nor a character device");
        target_ = resolved(path);
        open_temporary();
        // The new file gets the permissions of the replaced one.
        if (there && ::fchmod(descriptor_, old.st_mode & 07777U) != 0)
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
        const bool durable = durability == Durability::durable && !in_place();
        if (durable && ::fsync(descriptor_) != 0) discard_and_fail("cannot be made durable");
        if (in_place()) {
            if (::close(std::exchange(descriptor_, -1)) != 0) fail_errno("cannot be closed");
            return;
        }
        // Some file systems report a failed write at close. The lock must outlive the rename, so
        // close a second descriptor first.
        const int second = ::fcntl(descriptor_, F_DUPFD_CLOEXEC, 0);
        if (second < 0 || ::close(second) != 0) discard_and_fail("cannot be closed");
        if (::rename(temporary_.c_str(), target_.c_str()) != 0)
            discard_and_fail("cannot be replaced");
        temporary_.clear();
        discard();
        if (durable) sync_folder();
    }

private:
    static constexpr int most_names = 1000;  // temporary files of one target

    bool in_place() const { return temporary_.empty(); }
    static std::filesystem::path numbered(const std::filesystem::path& target, int i) {
        std::filesystem::path name = target;
        name += ".tmp-" + std::to_string(i);
        return name;
    }
    /// Returns true if the name refers to the open file: another process may have moved or
    /// removed it.
    static bool names(const std::filesystem::path& name, int descriptor) {
        struct stat a {}, b {};
        return ::fstat(descriptor, &a) == 0 && ::lstat(name.c_str(), &b) == 0 &&
               a.st_dev == b.st_dev && a.st_ino == b.st_ino;
    }
    /// Creates and locks the first temporary file that no running writer holds; removes those of
    /// ended writers.
    void open_temporary() {
        for (int i = 0; i < most_names; ++i) {
            const std::filesystem::path name = numbered(target_, i);
            const bool was_there = remove_abandoned(name);
            if (descriptor_ >= 0) {
                if (!was_there) return;
                continue;
            }
            descriptor_ = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
            if (descriptor_ < 0 && errno == EEXIST) continue;
            if (descriptor_ < 0) fail_errno("cannot be written");
            // Another writer may have removed it as abandoned since it was opened.
            const bool taken = ::flock(descriptor_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
            if (taken || !names(name, descriptor_)) {
                ::close(std::exchange(descriptor_, -1));
                continue;
            }
            temporary_ = name;
        }
        if (descriptor_ < 0)
            fail("cannot be written: " + numbered(target_, 0).string() + " to " +
                 std::to_string(most_names - 1) + " exist already");
    }
    /// Removes a temporary file that no running process holds; returns false if there is none. The
    /// owner renames it only under the lock, so under the lock the name refers to the same file.
    static bool remove_abandoned(const std::filesystem::path& name) {
        const int descriptor =
            ::open(name.c_str(), O_WRONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
        if (descriptor < 0) return errno != ENOENT;
        struct stat s {};
        if (::fstat(descriptor, &s) == 0 && S_ISREG(s.st_mode) &&
            ::flock(descriptor, LOCK_EX | LOCK_NB) == 0 && names(name, descriptor))
            ::unlink(name.c_str());
        ::close(descriptor);
        return true;
    }
    /// Resolves links: the target of a link is replaced, not the link.
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
        if (descriptor < 0) return;  // a writable folder without permission to read
        const int synced = ::fsync(descriptor);
        const int reason = errno;
        ::close(descriptor);
        // Some file systems have no fsync of folders; the file itself is complete either way.
        if (synced != 0 && reason != EINVAL && reason != ENOTSUP) {
            errno = reason;
            fail_errno("was replaced, but its folder cannot be made durable");
        }
    }
    void discard() {
        if (!temporary_.empty()) ::unlink(temporary_.c_str());  // under the lock
        temporary_.clear();
        if (descriptor_ >= 0) ::close(std::exchange(descriptor_, -1));
    }
    [[noreturn]] void fail(const std::string& message) const {
        throw Error(target_.string() + ": " + message);
    }
    [[noreturn]] void fail_errno(const std::string& message) const {
        fail(message + ": " + std::strerror(errno));
    }
    [[noreturn]] void discard_and_fail(const std::string& message) {
        const int reason = errno;
        const bool kept = !in_place();
        discard();
        errno = reason;
        fail_errno(message + (kept ? " (the old file is untouched)" : ""));
    }

    std::filesystem::path target_;
    std::filesystem::path temporary_;  // empty if there is none to remove
    int descriptor_ = -1;
};

/// Replaces a file by these bytes. Throws an Error as AtomicFile does, which leaves the old file.
inline void write_atomic(const std::filesystem::path& path, ByteSpan bytes,
                         Durability durability = Durability::durable) {
    AtomicFile file(path);
    file.write(bytes);
    file.commit(durability);
}

} // namespace rye
