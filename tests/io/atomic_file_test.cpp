// SPDX-License-Identifier: Apache-2.0
#include <rye/io/atomic_file.hpp>

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <sys/un.h>
#include <sys/wait.h>

#include <doctest/doctest.h>

#include "../support/hostile.hpp"

using namespace rye;
namespace fs = std::filesystem;

namespace {

std::string text_of(const fs::path& path) { return std::string(as_text(read_file(path))); }

} // namespace

TEST_CASE("atomic file: nothing appears under the name before commit") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "with space \xC3\xA9";
    {
        AtomicFile file(path);
        file.write(as_bytes("half"));
        CHECK(!fs::exists(path));
    }
    CHECK(files_in(folder.path) == 0);
    write_atomic(path, as_bytes("old"));
    {
        AtomicFile file(path);
        file.write(as_bytes("half"));
    }
    CHECK(text_of(path) == "old");
    write_atomic(path, as_bytes("new"));
    CHECK(text_of(path) == "new");
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("atomic file: two writers of one name do not mix") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a";
    AtomicFile first(path), second(path);
    first.write(as_bytes("first"));
    second.write(as_bytes("second"));
    second.commit();
    CHECK(text_of(path) == "second");
    first.commit();
    CHECK(text_of(path) == "first");
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("atomic file: permissions and links stay") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a", link = folder.path / "link";
    write_atomic(path, as_bytes("old"));
    fs::permissions(path, fs::perms::owner_read | fs::perms::owner_write | fs::perms::group_read);
    const fs::perms before = fs::status(path).permissions();
    fs::create_symlink("a", link);
    write_atomic(link, as_bytes("new"));
    CHECK(fs::is_symlink(link));
    CHECK(text_of(path) == "new");
    CHECK(fs::status(path).permissions() == before);
}

TEST_CASE("atomic file: places that cannot be written are named") {
    const TemporaryFolder folder;
    CHECK_FAULT(write_atomic(folder.path / "no" / "such" / "file", {}), "no/such/file: cannot be");
    CHECK_FAULT(write_atomic(folder.path, {}), "is a folder, not a file");
    CHECK(files_in(folder.path) == 0);
}

TEST_CASE("atomic file: when the disk is full the old file stays and nothing else is left") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a";
    write_atomic(path, as_bytes("old"));
    // A limit on the size of files simulates a full disk: write() is short, then fails.
    const ::pid_t child = ::fork();
    if (child == 0) {
        const ::rlimit limit{10000, 10000};
        std::signal(SIGXFSZ, SIG_IGN);
        int code = 1;
        if (::setrlimit(RLIMIT_FSIZE, &limit) == 0) {
            try {
                write_atomic(path, Bytes(100000));
                code = 2;
            } catch (const Error& e) {
                const std::string told = e.what();
                code = told.find("the old file is untouched") != std::string::npos ? 0 : 3;
            }
        }
        ::_exit(code);
    }
    int status = -1;
    REQUIRE(::waitpid(child, &status, 0) == child);
    CHECK(WIFEXITED(status));
    CHECK(WEXITSTATUS(status) == 0);
    CHECK(text_of(path) == "old");
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("atomic file: killed at any moment, the file is the old one or the new one, whole") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a";
    const std::string old(200000, 'o'), fresh(200000, 'n');
    write_atomic(path, as_bytes(old));
    for (int i = 0; i < 12; ++i) {
        const ::pid_t child = ::fork();
        if (child == 0) {
            for (;;) write_atomic(path, as_bytes(fresh));
        }
        ::usleep(static_cast<::useconds_t>(500 * i));
        ::kill(child, SIGKILL);
        int status = 0;
        ::waitpid(child, &status, 0);
        const std::string now = text_of(path);
        CHECK((now == old || now == fresh));
    }
    // The next write removes what the killed writers left.
    write_atomic(path, as_bytes(fresh));
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("atomic file: what dead writers left goes, what living writers hold stays") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a";
    // Three concurrent writers, two of which are killed.
    int ready[2], go[2];
    REQUIRE(::pipe(ready) == 0);
    REQUIRE(::pipe(go) == 0);
    std::array<::pid_t, 3> child{};
    char byte = 0;
    for (::pid_t& c : child) {
        c = ::fork();
        if (c == 0) {
            AtomicFile file(path);
            file.write(as_bytes("living"));
            bool done = ::write(ready[1], "x", 1) == 1 && ::read(go[0], &byte, 1) == 1;
            file.commit();
            ::_exit(done ? 0 : 1);
        }
        REQUIRE(::read(ready[0], &byte, 1) == 1);
    }
    CHECK(files_in(folder.path) == 3);
    int status = -1;
    for (const std::size_t i : {0U, 2U}) {
        ::kill(child[i], SIGKILL);
        ::waitpid(child[i], &status, 0);
    }
    CHECK(files_in(folder.path) == 3);
    write_atomic(path, as_bytes("mine"));
    CHECK(text_of(path) == "mine");
    CHECK(files_in(folder.path) == 2); // the target and the running writer's
    REQUIRE(::write(go[1], "x", 1) == 1);
    ::waitpid(child[1], &status, 0);
    CHECK(status == 0);
    CHECK(text_of(path) == "living");
    CHECK(files_in(folder.path) == 1);
    for (const int d : {ready[0], ready[1], go[0], go[1]}) ::close(d);
}

TEST_CASE("atomic file: many writers at once lose no temporary file to each other") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "a";
    std::atomic<int> failed = 0;
    std::vector<std::thread> writers;
    for (int t = 0; t < 4; ++t)
        writers.emplace_back([&] {
            for (int i = 0; i < 200; ++i) try {
                    write_atomic(path, as_bytes("whole"), Durability::atomic_only);
                } catch (const Error&) {
                    ++failed;
                }
        });
    for (std::thread& w : writers) w.join();
    CHECK(failed == 0);
    CHECK(text_of(path) == "whole");
    CHECK(files_in(folder.path) == 1);
}

TEST_CASE("atomic file: a pipe is written in place and stays a pipe, so does a device") {
    const TemporaryFolder folder;
    const fs::path pipe = folder.path / "pipe";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    std::string got;
    std::thread reader([&] {
        std::ifstream in(pipe);
        got.assign(std::istreambuf_iterator<char>(in), {});
    });
    write_atomic(pipe, as_bytes("through a pipe"));
    reader.join();
    CHECK(got == "through a pipe");
    CHECK(fs::is_fifo(pipe));
    // Through a link, as /dev/stdout is one. A pipe replaces the machine's own device.
    const fs::path link = folder.path / "link";
    fs::create_symlink("pipe", link);
    std::thread second([&] {
        std::ifstream in(pipe);
        got.assign(std::istreambuf_iterator<char>(in), {});
    });
    write_atomic(link, as_bytes("by a link"));
    second.join();
    CHECK(got == "by a link");
    CHECK(fs::is_symlink(link));
    CHECK(fs::is_fifo(pipe));
    // A null device made by this test, which needs root.
    const fs::path device = folder.path / "null";
    if (::mknod(device.c_str(), S_IFCHR | 0600, ::makedev(1, 3)) != 0) {
        MESSAGE("skipped: a device cannot be made here: ", std::strerror(errno));
        return;
    }
    try {
        write_atomic(device, as_bytes("nothing"));
    } catch (const Error& e) { // a folder mounted without devices
        MESSAGE("the device cannot be opened here: ", std::string(e.what()));
    }
    CHECK(fs::is_character_file(device));
    CHECK(files_in(folder.path) == 3);
}

TEST_CASE("atomic file: a socket is refused") {
    const TemporaryFolder folder;
    const fs::path path = folder.path / "s";
    const int s = ::socket(AF_UNIX, SOCK_STREAM, 0);
    ::sockaddr_un address{};
    address.sun_family = AF_UNIX;
    std::strncpy(address.sun_path, path.c_str(), sizeof address.sun_path - 1);
    REQUIRE(::bind(s, reinterpret_cast<const ::sockaddr*>(&address), sizeof address) == 0);
    CHECK_FAULT(write_atomic(path, as_bytes("x")), "is neither a file nor a pipe");
    CHECK(fs::is_socket(path));
    ::close(s);
}

TEST_CASE("read_file: a pipe that nobody writes is refused, not waited for") {
    const TemporaryFolder folder;
    const fs::path pipe = folder.path / "pipe";
    REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
    CHECK_FAULT(read_file(pipe), "pipe: not a file");
    CHECK_FAULT(read_beginning(pipe, 8), "pipe: not a file");
    CHECK_FAULT(read_file(folder.path), "not a file");
}
