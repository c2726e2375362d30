// SPDX-License-Identifier: Apache-2.0
/// tests/support/limited.hpp: code in a child process with a limit of the system's, on Linux.
#pragma once

#if defined(__linux__) && !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define RYE_HAS_LIMITS

#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <string>

namespace rye::test {

/// At most that many processes and threads of a user who has no others: root's are not limited.
inline bool limit_threads(rlim_t most) {
    constexpr uid_t nobody = 65534;
    const rlimit limit{most, most};
    return setrlimit(RLIMIT_NPROC, &limit) == 0 && (getuid() != 0 || setuid(nobody) == 0);
}

/// At most that many bytes of address space beside those in use.
inline bool limit_memory(rlim_t more) {
    std::FILE* file = std::fopen("/proc/self/statm", "r");
    unsigned long pages = 0;
    const bool read = file != nullptr && std::fscanf(file, "%lu", &pages) == 1;
    if (file != nullptr) std::fclose(file);
    const rlim_t most = pages * static_cast<rlim_t>(sysconf(_SC_PAGESIZE)) + more;
    const rlimit limit{most, most};
    return read && setrlimit(RLIMIT_AS, &limit) == 0;
}

/// Whether f(), called in a child process, returns true within `seconds`; "" if so, else what
/// happened instead.
template <class F>
std::string in_child(unsigned seconds, F&& f) {
    std::fflush(nullptr);
    const pid_t child = fork();
    if (child < 0) return "no child process";
    if (child == 0) {
        alarm(seconds);
        bool good = false;
        try {
            good = f();
        } catch (...) {
        }
        _exit(good ? 0 : 1);
    }
    int status = 0;
    if (waitpid(child, &status, 0) != child) return "the child was not waited for";
    if (WIFSIGNALED(status)) return strsignal(WTERMSIG(status));
    return WEXITSTATUS(status) == 0 ? "" : "it returned false or threw";
}

/// Whether the system keeps limits of memory: qemu, which runs programs of other processors, does
/// not.
inline bool limits_memory() {
    constexpr std::size_t more = std::size_t(64) << 20;
    return in_child(20, [] {
        return limit_memory(more) && mmap(nullptr, 2 * more, PROT_READ,
                                          MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) == MAP_FAILED;
    }) == "";
}

} // namespace rye::test

#endif
