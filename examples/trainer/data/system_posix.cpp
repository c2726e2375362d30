// SPDX-License-Identifier: Apache-2.0
#include "data/system.hpp"

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <rye/core/error.hpp>

namespace rye::trainer {

namespace fs = std::filesystem;

void begin_program(int&, char**&) {}

std::optional<std::string> environment(const char* name) {
    const char* const value = std::getenv(name);
    if (value == nullptr || *value == '\0') return std::nullopt;
    return value;
}

int code_of_stop(int signal) { return 128 + signal; }
void ignore_file_size_signal() { std::signal(SIGXFSZ, SIG_IGN); }

bool is_terminal(Stream stream) { return ::isatty(static_cast<int>(stream)) != 0; }

std::size_t terminal_width() {
    struct winsize size {};
    return ::ioctl(STDOUT_FILENO, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
}

void write_output(ByteSpan bytes) {
    while (!bytes.empty()) {
        const ::ssize_t n = ::write(STDOUT_FILENO, bytes.data(), bytes.size());
        if (n < 0 && errno == EINTR) continue;
        require(n > 0, "standard output",
                "cannot be written: ", [&] { return std::strerror(errno); });
        bytes = bytes.subspan(static_cast<std::size_t>(n));
    }
}

double machine_memory() {
    double bytes = static_cast<double>(::sysconf(_SC_PHYS_PAGES)) *
                   static_cast<double>(::sysconf(_SC_PAGE_SIZE));
    rlimit limit{};
    for (const auto kind : {RLIMIT_AS, RLIMIT_DATA})
        if (::getrlimit(kind, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY)
            bytes = std::min(bytes, static_cast<double>(limit.rlim_cur));
    return bytes;
}

fs::path program_file() {
    std::error_code ignored;
    return fs::read_symlink("/proc/self/exe", ignored);
}

namespace {

std::string host_name() {
    std::array<char, 256> host{};
    if (::gethostname(host.data(), host.size() - 1) != 0) host[0] = '\0';
    return host.data();
}

} // namespace

std::string system_name() {
    std::ifstream file("/proc/sys/kernel/random/boot_id");
    std::string name;
    return std::getline(file, name) && !name.empty() ? name : host_name();
}

std::string process_words() {
    std::array<char, 32> since{};
    const std::time_t now = std::time(nullptr);
    std::tm utc{};
    if (::gmtime_r(&now, &utc) != nullptr)
        std::strftime(since.data(), since.size(), "%Y-%m-%dT%H:%M:%SZ", &utc);
    return "process " + std::to_string(::getpid()) + " on " + host_name() + " since " +
           since.data();
}

AppendedFile::AppendedFile(const fs::path& path)
    : file_(::open(path.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC)) {
    require(file_ >= 0, path.string(), "cannot be written: ", [&] { return std::strerror(errno); });
}

AppendedFile::~AppendedFile() { ::close(file_); }

std::optional<AppendedFile::Failure> AppendedFile::append(std::string_view text) {
    const ::off_t before = ::lseek(file_, 0, SEEK_END);
    std::size_t done = 0;
    while (done < text.size()) {
        const ::ssize_t n = ::write(file_, text.data() + done, text.size() - done);
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) {
            const std::string reason = std::strerror(errno);
            return Failure{reason, done == 0 || ::ftruncate(file_, before) == 0};
        }
        done += static_cast<std::size_t>(n);
    }
    return std::nullopt;
}

LockFile::LockFile(fs::path path, bool children_too)
    : path_(std::move(path)),
      children_too_(children_too) {
    // Not closed by exec if children are to hold it, too.
    file_ = ::open(path_.c_str(), O_RDWR | O_CREAT | (children_too_ ? 0 : O_CLOEXEC), 0666);
    require(file_ >= 0, path_.string(), "cannot be written: ", [&] { return std::strerror(errno); });
}

LockFile::~LockFile() { ::close(file_); }

LockFile::Taking LockFile::take() {
    while (::flock(file_, LOCK_EX | LOCK_NB) != 0)
        if (errno != EINTR)
            return errno == EWOULDBLOCK ? Taking::held_by_another : Taking::no_locks;
    return Taking::done;
}

LockFile::Taking LockFile::look(const fs::path& path) {
    const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
    if (file < 0 && errno == ENOENT) return Taking::done;
    require(file >= 0, path.string(), "cannot be read: ", [&] { return std::strerror(errno); });
    int failed = 0;
    while ((failed = ::flock(file, LOCK_SH | LOCK_NB)) != 0 && errno == EINTR) continue;
    const int reason = errno;
    ::close(file);
    return failed == 0             ? Taking::done
           : reason == EWOULDBLOCK ? Taking::held_by_another
                                   : Taking::no_locks;
}

std::string LockFile::words() const {
    std::string text(400, '\0');
    const ::ssize_t n = ::pread(file_, text.data(), text.size(), 0);
    text.resize(n < 0 ? 0 : static_cast<std::size_t>(n));
    return text;
}

void LockFile::write(const std::string& words) {
    if (::ftruncate(file_, 0) == 0 && ::pwrite(file_, words.data(), words.size(), 0) < 0) return;
}

} // namespace rye::trainer
