// SPDX-License-Identifier: Apache-2.0
#include <rye/capture/atomic_file.hpp>

#include <csignal>
#include <filesystem>
#include <string>

#include <sys/resource.h>
#include <sys/wait.h>

#include <doctest/doctest.h>

#include "hostile.hpp"

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
    // A limit on the size of files stands for a full disk: write() falls short, then fails.
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
}
