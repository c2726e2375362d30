// SPDX-License-Identifier: Apache-2.0
/// rye/io/atomic_file.hpp: atomic replacement of a file by a complete one.
/// Writes to a temporary file in the same folder, NAME.tmp-0; commit() makes it durable (fsync),
/// renames it over the target, and makes the rename durable (fsync of the folder). Without
/// commit() the target is unchanged and the temporary file is removed. Durability survives a power
/// cut and costs milliseconds; a file that can be regenerated need only be atomic.
///
/// A killed process leaves its temporary file. A writer holds its own (core/held_file.hpp) while
/// the process runs; the next writer of the same target removes those that nobody holds. On a POSIX
/// file system without locks they stay.
///
/// A pipe or a character device (/dev/null, /dev/stdout) cannot be replaced: it is written in place
/// immediately. Folders, block devices and sockets are rejected.
#pragma once

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <string>
#include <system_error>

#include <rye/io/bytes.hpp>
#include <rye/core/error.hpp>
#include <rye/core/held_file.hpp>

namespace rye {

/// Durability of a written file: it survives a power cut, or is only replaced as a whole.
enum class Durability { durable, atomic_only };

/// File that replaces another when it is committed. Throws an Error, with the path, if the system
/// refuses.
class AtomicFile {
public:
    explicit AtomicFile(const std::filesystem::path& path) : target_(path) {
        using Kind = std::filesystem::file_type;
        std::error_code unknown;
        const std::filesystem::file_status old = std::filesystem::status(path, unknown);
        const bool there = std::filesystem::exists(old);
        if (old.type() == Kind::directory) fail("is a folder, not a file");
        if (old.type() == Kind::fifo || old.type() == Kind::character) {
            if (!file_.open_in_place(path)) fail_errno("cannot be written");
            return;
        }
        if (there && old.type() != Kind::regular)
            fail("is neither a file nor a pipe nor a character device");
        target_ = resolved(path);
        open_temporary();
        // The new file gets the permissions of the replaced one.
        if (there && !file_.permit(old.permissions()))
            discard_and_fail("its permissions cannot be kept");
    }
    AtomicFile(const AtomicFile&) = delete;
    AtomicFile& operator=(const AtomicFile&) = delete;
    ~AtomicFile() { discard(); }

    void write(ByteSpan bytes) {
        if (!file_.write(bytes)) discard_and_fail("cannot be written");
    }

    void commit(Durability durability = Durability::durable) {
        const bool durable = durability == Durability::durable && !in_place();
        if (durable && !file_.make_durable()) discard_and_fail("cannot be made durable");
        if (in_place()) {
            if (!file_.close()) fail_errno("cannot be closed");
            return;
        }
        // It must be held until it has its name.
        if (!file_.check_close()) discard_and_fail("cannot be closed");
        if (!detail::HeldFile::replace(temporary_, target_))
            discard_and_fail("cannot be replaced");
        temporary_.clear();
        const bool synced = !durable || file_.sync_folder(target_.parent_path());
        const int reason = errno;
        discard();
        errno = reason;
        if (!synced) fail_errno("was replaced, but its folder cannot be made durable");
    }

private:
    static constexpr int most_names = 1000;  // temporary files of one target

    bool in_place() const { return temporary_.empty(); }
    static std::filesystem::path numbered(const std::filesystem::path& target, int i) {
        std::filesystem::path name = target;
        name += ".tmp-" + std::to_string(i);
        return name;
    }
    /// Creates the first temporary file that no running writer holds; removes those of ended
    /// writers.
    void open_temporary() {
        for (int i = 0; i < most_names; ++i) {
            const std::filesystem::path name = numbered(target_, i);
            const bool was_there = detail::HeldFile::remove_abandoned(name);
            if (file_.is_open()) {
                if (!was_there) return;
                continue;
            }
            const detail::Creation created = file_.create(name);
            if (created == detail::Creation::failed) fail_errno("cannot be written");
            if (created == detail::Creation::done) temporary_ = name;
        }
        if (!file_.is_open())
            fail("cannot be written: " + numbered(target_, 0).string() + " to " +
                 std::to_string(most_names - 1) + " exist already");
    }
    /// Resolves links: the target of a link is replaced, not the link.
    static std::filesystem::path resolved(const std::filesystem::path& path) {
        std::error_code status;
        if (!std::filesystem::is_symlink(path, status)) return path;
        const std::filesystem::path target = std::filesystem::weakly_canonical(path, status);
        return status ? path : target;
    }
    void discard() {
        if (!temporary_.empty()) detail::HeldFile::remove(temporary_);  // while it is held
        temporary_.clear();
        file_.close();
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
    detail::HeldFile file_;
};

/// Replaces a file by these bytes. Throws an Error as AtomicFile does, which leaves the old file.
inline void write_atomic(const std::filesystem::path& path, ByteSpan bytes,
                         Durability durability = Durability::durable) {
    AtomicFile file(path);
    file.write(bytes);
    file.commit(durability);
}

} // namespace rye
