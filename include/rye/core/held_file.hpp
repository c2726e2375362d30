// SPDX-License-Identifier: Apache-2.0
/// rye/core/held_file.hpp: file under a temporary name that its writer holds while the process
/// runs: POSIX locks it (flock), Windows refuses others who would write to it. What differs between
/// systems in AtomicFile. Functions that return false set errno.
#pragma once

#include <algorithm>
#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <utility>

#include <fcntl.h>
#ifdef _WIN32
#include <io.h>
struct _SECURITY_ATTRIBUTES;
#else
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>
#endif

namespace rye::detail {

#ifdef _WIN32
/// Functions of the system, declared here as <windows.h> has them: its macros would reach every
/// program that includes rye.
extern "C" {
__declspec(dllimport) void* __stdcall CreateFileW(const wchar_t*, unsigned long, unsigned long,
                                                  struct _SECURITY_ATTRIBUTES*, unsigned long,
                                                  unsigned long, void*);
__declspec(dllimport) int __stdcall CloseHandle(void*);
__declspec(dllimport) int __stdcall MoveFileExW(const wchar_t*, const wchar_t*, unsigned long);
__declspec(dllimport) unsigned long __stdcall GetLastError();
__declspec(dllimport) void __stdcall Sleep(unsigned long);
}
#endif

/// Result of creating a file under a name of its own.
enum class Creation { done, taken, failed };

/// File that is open for writing, or none.
class HeldFile {
public:
    HeldFile() = default;
    HeldFile(const HeldFile&) = delete;
    HeldFile& operator=(const HeldFile&) = delete;
    ~HeldFile() { close(); }
    bool is_open() const { return descriptor_ >= 0; }

    /// Opens a pipe or a device, to write in place.
    bool open_in_place(const std::filesystem::path& path);
    /// Creates and holds a new file; taken: there is one of that name, or another writer removed
    /// it.
    Creation create(const std::filesystem::path& name);
    /// Removes a file that no running process holds; returns whether there is something of that
    /// name, or was.
    static bool remove_abandoned(const std::filesystem::path& name);
    /// Removes the held file.
    static void remove(const std::filesystem::path& name);
    /// Gives it permissions, where the system has them for a file.
    bool permit(std::filesystem::perms permissions);
    bool write(std::span<const std::byte> bytes);
    bool make_durable();
    /// Reports what a close would report, and keeps the file held.
    bool check_close();
    /// Puts the held file in another's place.
    static bool replace(const std::filesystem::path& name, const std::filesystem::path& target);
    /// Makes a replacement durable.
    bool sync_folder(const std::filesystem::path& folder);
    bool close();

private:
    int descriptor_ = -1;
};

#ifndef _WIN32

inline bool HeldFile::open_in_place(const std::filesystem::path& path) {
    descriptor_ = ::open(path.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC);
    return is_open();
}
/// Returns true if the name refers to the open file: another process may have moved or removed it.
inline bool names(const std::filesystem::path& name, int descriptor) {
    struct stat a {}, b {};
    return ::fstat(descriptor, &a) == 0 && ::lstat(name.c_str(), &b) == 0 && a.st_dev == b.st_dev &&
           a.st_ino == b.st_ino;
}
inline Creation HeldFile::create(const std::filesystem::path& name) {
    descriptor_ = ::open(name.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (!is_open()) return errno == EEXIST ? Creation::taken : Creation::failed;
    // Another writer may have removed it as abandoned since it was opened.
    const bool locked = ::flock(descriptor_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
    if (!locked && names(name, descriptor_)) return Creation::done;
    close();
    return Creation::taken;
}
inline bool HeldFile::remove_abandoned(const std::filesystem::path& name) {
    const int descriptor = ::open(name.c_str(), O_WRONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (descriptor < 0) return errno != ENOENT;
    // The owner renames it only under the lock, so under the lock the name refers to the same file.
    struct stat s {};
    if (::fstat(descriptor, &s) == 0 && S_ISREG(s.st_mode) &&
        ::flock(descriptor, LOCK_EX | LOCK_NB) == 0 && names(name, descriptor))
        ::unlink(name.c_str());
    ::close(descriptor);
    return true;
}
inline void HeldFile::remove(const std::filesystem::path& name) { ::unlink(name.c_str()); }
inline bool HeldFile::permit(std::filesystem::perms permissions) {
    return ::fchmod(descriptor_, static_cast<::mode_t>(permissions) & 07777U) == 0;
}
inline bool HeldFile::write(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        const ::ssize_t n = ::write(descriptor_, bytes.data(), bytes.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) return false;
        bytes = bytes.subspan(static_cast<std::size_t>(n));
    }
    return true;
}
inline bool HeldFile::make_durable() { return ::fsync(descriptor_) == 0; }
inline bool HeldFile::check_close() { // some file systems report a failed write at close
    const int second = ::fcntl(descriptor_, F_DUPFD_CLOEXEC, 0);
    return second >= 0 && ::close(second) == 0;
}
inline bool HeldFile::replace(const std::filesystem::path& name,
                              const std::filesystem::path& target) {
    return ::rename(name.c_str(), target.c_str()) == 0;
}
inline bool HeldFile::sync_folder(const std::filesystem::path& folder) {
    const int descriptor =
        ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (descriptor < 0) return true; // a writable folder without permission to read
    const int synced = ::fsync(descriptor);
    const int reason = errno;
    ::close(descriptor);
    errno = reason;
    // Some file systems have no fsync of folders; the file itself is complete either way.
    return synced == 0 || reason == EINVAL || reason == ENOTSUP;
}
inline bool HeldFile::close() {
    return !is_open() || ::close(std::exchange(descriptor_, -1)) == 0;
}

#else

/// Sets errno to the system's last error.
inline void set_errno() {
    switch (GetLastError()) {
    case 2:
    case 3: errno = ENOENT; break;
    case 5:
    case 32:
    case 33: errno = EACCES; break; // denied; open by another process
    case 39:
    case 112: errno = ENOSPC; break;
    case 80:
    case 183: errno = EEXIST; break;
    case 206: errno = ENAMETOOLONG; break;
    case 123: errno = EINVAL; break; // a character that names do not have
    default: errno = EIO;
    }
}
inline bool HeldFile::open_in_place(const std::filesystem::path& path) {
    descriptor_ = ::_wopen(path.c_str(), _O_WRONLY | _O_BINARY | _O_NOINHERIT);
    return is_open();
}
/// Opens a file by the system's numbers; returns null if it refuses.
inline void* open_handle(const std::filesystem::path& name, unsigned long access,
                         unsigned long others, unsigned long creation, unsigned long flags) {
    void* const handle =
        CreateFileW(name.c_str(), access, others, nullptr, creation, flags, nullptr);
    if (handle != reinterpret_cast<void*>(-1)) return handle;
    set_errno();
    return nullptr;
}
inline constexpr unsigned long may_write = 0x40000000, may_remove = 0x10000, others_read = 1,
                               others_remove = 4;
inline Creation HeldFile::create(const std::filesystem::path& name) {
    constexpr unsigned long as_new = 1, ordinary = 0x80;
    void* const handle =
        open_handle(name, may_write, others_read | others_remove, as_new, ordinary);
    if (handle == nullptr) return errno == EEXIST ? Creation::taken : Creation::failed;
    descriptor_ = ::_open_osfhandle(reinterpret_cast<std::intptr_t>(handle), _O_BINARY);
    return is_open() ? Creation::done : Creation::failed;
}
inline bool HeldFile::remove_abandoned(const std::filesystem::path& name) {
    constexpr unsigned long as_is = 3, removed_by_close = 0x04000000;
    void* const handle = open_handle(name, may_write | may_remove, 0, as_is, removed_by_close);
    if (handle == nullptr) return errno != ENOENT; // a running writer lets no other write
    CloseHandle(handle);
    return true;
}
inline void HeldFile::remove(const std::filesystem::path& name) { ::_wunlink(name.c_str()); }
inline bool HeldFile::permit(std::filesystem::perms) { return true; } // the folder's
inline bool HeldFile::write(std::span<const std::byte> bytes) {
    while (!bytes.empty()) {
        constexpr std::size_t most = 1U << 24U;
        const int n = ::_write(descriptor_, bytes.data(),
                               static_cast<unsigned>(std::min(bytes.size(), most)));
        if (n <= 0) return false;
        bytes = bytes.subspan(static_cast<std::size_t>(n));
    }
    return true;
}
inline bool HeldFile::make_durable() { return ::_commit(descriptor_) == 0; }
inline bool HeldFile::check_close() { return true; }
inline bool HeldFile::replace(const std::filesystem::path& name,
                              const std::filesystem::path& target) {
    // A file that another process has open is not replaced: most close it in less than a second.
    constexpr unsigned long replacing = 1, at_once = 8, pause = 50;
    for (int i = 0;; ++i) {
        if (MoveFileExW(name.c_str(), target.c_str(), replacing | at_once) != 0) return true;
        set_errno();
        if (errno != EACCES || i == 20) return false;
        Sleep(pause);
    }
}
inline bool HeldFile::sync_folder(const std::filesystem::path&) { return make_durable(); }
inline bool HeldFile::close() {
    return !is_open() || ::_close(std::exchange(descriptor_, -1)) == 0;
}

#endif

} // namespace rye::detail
