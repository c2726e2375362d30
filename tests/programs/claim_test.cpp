// SPDX-License-Identifier: Apache-2.0
// Claims of folders that several machines share. Another machine is a file with its name.
#include "data/claim.hpp"

#include <fstream>
#include <thread>

#include <doctest/doctest.h>

#include "../support/file_bytes.hpp"
#include "../support/hostile.hpp"

using namespace rye::trainer;
namespace fs = std::filesystem;

namespace {

using Milliseconds = std::chrono::milliseconds;
using Clock = std::chrono::steady_clock;

constexpr ClaimTimes quick{Milliseconds(20), Milliseconds(400), Milliseconds(10)};

void write_claim(const fs::path& file, const std::string& text) { std::ofstream(file) << text; }

/// Returns a claim, or null if another holds the folder for as long.
std::unique_ptr<Claim> take_within(const fs::path& folder, Milliseconds longest,
                                   std::string* holder = nullptr) {
    const auto since = Clock::now();
    return Claim::take(
        folder,
        [&](const std::string& words) {
            if (holder != nullptr) *holder = words;
            return Clock::now() - since < longest;
        },
        quick);
}

} // namespace

TEST_CASE("claim: one process has it, and others learn its name") {
    const TemporaryFolder folder;
    CHECK(!claimed_by(folder.path, quick));
    auto claim = take_within(folder.path, Milliseconds(0));
    REQUIRE(claim);
    const std::string text = bytes_of(folder.path / "task.claim");
    CHECK(text.starts_with(system_name() + "\nprocess "));
    std::string holder;
    CHECK(!take_within(folder.path, Milliseconds(250), &holder));
    CHECK(text.find("\n" + holder + "\n") != std::string::npos);
    CHECK(claimed_by(folder.path, quick) == holder);
    CHECK(LockFile::look(folder.path / "task.lock") == LockFile::Taking::held_by_another);
    CHECK(claim->renew());
    claim.reset();
    CHECK(!fs::exists(folder.path / "task.claim"));
    CHECK(LockFile::look(folder.path / "task.lock") == LockFile::Taking::done);
    CHECK(!claimed_by(folder.path, quick));
    CHECK(take_within(folder.path, Milliseconds(0)));
    for (const auto& left : fs::directory_iterator(folder.path))
        CHECK(left.path().filename() == "task.lock");
}

TEST_CASE("claim: what an ended process of this system left is void at once") {
    const TemporaryFolder folder;
    write_claim(folder.path / "task.lock", "");
    write_claim(folder.path / "task.claim", system_name() + "\nprocess 1 on it since then\n7\n");
    CHECK(!claimed_by(folder.path, quick));
    CHECK(take_within(folder.path, Milliseconds(0)));
}

TEST_CASE("claim: another machine's is void once it stands still, and not while it beats") {
    const TemporaryFolder folder;
    const fs::path file = folder.path / "task.claim";
    write_claim(folder.path / "task.lock", "");
    for (const std::string text :
         {"elsewhere\nprocess 1 on elsewhere since then\n1\n", "", "\x01\xff"}) {
        INFO(text);
        write_claim(file, text);
        CHECK(claimed_by(folder.path, quick));
        CHECK(!take_within(folder.path, Milliseconds(100)));
        CHECK(bytes_of(file) == text);
        // Beats for longer than the patience.
        int beats = 0;
        const auto since = Clock::now();
        const auto beating = Claim::take(
            folder.path,
            [&](const std::string&) {
                write_claim(file, text + std::to_string(++beats));
                return Clock::now() - since < Milliseconds(700);
            },
            quick);
        CHECK(!beating);
        const auto claim = take_within(folder.path, Milliseconds(5000));
        REQUIRE(claim);
        CHECK(bytes_of(file).starts_with(system_name() + "\n"));
    }
    write_claim(file, "elsewhere\nprocess 1 on elsewhere since then\n1\n");
    fs::last_write_time(file, fs::file_time_type::clock::now() - Milliseconds(500));
    CHECK(!claimed_by(folder.path, quick));
}

TEST_CASE("claim: its holder learns that another took it, and leaves that one's") {
    const TemporaryFolder folder;
    const fs::path file = folder.path / "task.claim";
    auto claim = take_within(folder.path, Milliseconds(0));
    REQUIRE(claim);
    const std::string other = "elsewhere\nprocess 1 on elsewhere since then\n1\n";
    write_claim(file, other);
    std::this_thread::sleep_for(2 * quick.beat);
    CHECK(!claim->renew());
    CHECK(!claim->renew());
    claim.reset();
    CHECK(bytes_of(file) == other);
}

TEST_CASE("claim: a file that is away for a while is no other's") {
    const TemporaryFolder folder;
    auto claim = take_within(folder.path, Milliseconds(0));
    REQUIRE(claim);
    fs::remove(folder.path / "task.claim");
    std::this_thread::sleep_for(2 * quick.beat);
    CHECK(claim->renew());
    CHECK(fs::exists(folder.path / "task.claim"));
    CHECK_FAULT(take_within(folder.path / "nowhere", Milliseconds(0)),
                "nowhere/task.lock: cannot be");
}
