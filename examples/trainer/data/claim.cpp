// SPDX-License-Identifier: Apache-2.0
#include "data/claim.hpp"

#include <span>
#include <thread>
#include <utility>

#include <rye/io/atomic_file.hpp>
#include <rye/core/checksum.hpp>

namespace rye::trainer {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

fs::path claim_file(const fs::path& folder) { return folder / "task.claim"; }
fs::path lock_file(const fs::path& folder) { return folder / "task.lock"; }

/// Returns the text of a claim; empty without one, two empty lines for one that cannot be read.
std::string text_of(const fs::path& file) {
    std::string text;
    try {
        constexpr std::uint64_t most = 4096;
        text = std::string(as_text(read_file(file, most)));
    } catch (const Error&) {
        std::error_code fault;
        if (fs::symlink_status(file, fault).type() == fs::file_type::not_found) return "";
    }
    return text.empty() ? "\n\n" : text;
}

/// Returns a line of a claim: 0 the system, 1 the holder, 2 the number of its beats.
std::string line_of(const std::string& text, int line) {
    std::size_t at = 0;
    for (; line > 0 && at < text.size(); --line) {
        const std::size_t end = text.find('\n', at);
        at = end == std::string::npos ? text.size() : end + 1;
    }
    std::string words;
    for (; at < text.size() && text[at] != '\n'; ++at)
        words += text[at] >= ' ' && text[at] < 127 ? text[at] : '?';
    return words;
}

std::string holder_of(const std::string& text) {
    const std::string words = line_of(text, 1);
    return words.empty() ? "another process of rye" : words;
}

} // namespace

Claim::Claim(const fs::path& folder, const ClaimTimes& times)
    : file_(claim_file(folder)),
      times_(times),
      lock_(lock_file(folder), true),
      holder_(process_words()) {}

Claim::~Claim() {
    std::error_code ignored;
    if (held_ && holder_of(text_of(file_)) == holder_) fs::remove(file_, ignored);
}

void Claim::write(const fs::path& file) {
    const std::string text =
        system_name() + "\n" + holder_ + "\n" + std::to_string(++beats_) + "\n";
    write_atomic(file, std::as_bytes(std::span(text)), Durability::atomic_only);
    last_ = Clock::now();
}

/// Makes the claim where there is none; returns false if another process was faster.
bool Claim::create() {
    // A link is made by one process alone, also on network file systems.
    const fs::path own = file_.string() + "-" + checksum_text(crc32(as_bytes(holder_)));
    write(own);
    std::error_code fault, ignored;
    fs::create_hard_link(own, file_, fault);
    fs::remove(own, ignored);
    if (fault == std::errc::file_exists) return false;
    return fault ? replace() : true; // a file system without links
}

/// Replaces what is there; returns false if another process did so, too, and later.
bool Claim::replace() {
    write(file_);
    std::this_thread::sleep_for(times_.settle);
    return holder_of(text_of(file_)) == holder_;
}

std::unique_ptr<Claim> Claim::take(const fs::path& folder,
                                   const std::function<bool(const std::string&)>& go_on,
                                   const ClaimTimes& times) {
    using Taking = LockFile::Taking;
    std::unique_ptr<Claim> claim(new Claim(folder, times));
    Taking lock = Taking::held_by_another;
    std::string seen;
    Clock::time_point since{};
    for (;; std::this_thread::sleep_for(std::chrono::milliseconds(100))) {
        if (lock == Taking::held_by_another) lock = claim->lock_.take();
        const std::string text = text_of(claim->file_);
        if (text != seen) seen = text, since = Clock::now();
        if (lock != Taking::held_by_another) {
            if (text.empty()) {
                claim->held_ = claim->create();
            } else if (lock == Taking::done && line_of(text, 0) == system_name()) {
                claim->write(claim->file_); // its holder has ended: it would have the lock
                claim->held_ = true;
            } else if (Clock::now() - since >= times.patience) {
                claim->held_ = claim->replace();
            }
            if (claim->held_) return claim;
        }
        if (!go_on(holder_of(text))) return nullptr;
    }
}

bool Claim::renew() {
    if (!held_) return false;
    if (Clock::now() - last_ < times_.beat) return true;
    try {
        const std::string holder = line_of(text_of(file_), 1); // empty: it cannot be read now
        if (!holder.empty() && holder != holder_) return held_ = false;
        write(file_);
    } catch (const Error&) {
        last_ = Clock::now() - times_.beat + std::chrono::seconds(1);
    }
    return true;
}

std::optional<std::string> claimed_by(const fs::path& folder, const ClaimTimes& times) {
    const std::string text = text_of(claim_file(folder));
    const LockFile::Taking taking = LockFile::look(lock_file(folder));
    if (taking == LockFile::Taking::held_by_another) return holder_of(text);
    if (text.empty() || (taking == LockFile::Taking::done && line_of(text, 0) == system_name()))
        return std::nullopt;
    std::error_code fault;
    const auto written = fs::last_write_time(claim_file(folder), fault);
    if (fault || fs::file_time_type::clock::now() - written > times.patience) return std::nullopt;
    return holder_of(text);
}

} // namespace rye::trainer
