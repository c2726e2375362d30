// SPDX-License-Identifier: Apache-2.0
/// data/claim.hpp: claim of a folder on a file system that several machines share, of which one
/// process at a time works there. A FolderLock alone does not suffice: some file systems lock for
/// each machine apart, and others keep the lock of a machine that vanished.
///
/// Two files: task.lock, which the holder and its children have locked, and task.claim, which names
/// the holder and changes at every `beat`. A claim is void if it is of this system and the lock is
/// free, or if it did not change for the time of `patience` by the observer's own clock: clocks of
/// machines are not compared. A holder whose claim was taken (its machine was away) learns it at
/// its next beat.
#pragma once

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "data/system.hpp"

namespace rye::trainer {

/// Times of claims; the same in all processes of a folder.
struct ClaimTimes {
    std::chrono::milliseconds beat{15000};
    std::chrono::milliseconds patience{120000};
    std::chrono::milliseconds settle{2000}; ///< until machines see one another's claims
};

/// Claim that this process holds.
class Claim {
  public:
    /// Returns the claim of a folder, waiting while another process holds it; null if `go_on`,
    /// called with the holder's words several times a second, returns false. Throws an Error if
    /// the folder cannot be written to.
    static std::unique_ptr<Claim> take(const std::filesystem::path& folder,
                                       const std::function<bool(const std::string&)>& go_on,
                                       const ClaimTimes& times = {});
    /// Ends the claim.
    ~Claim();
    Claim(const Claim&) = delete;
    Claim& operator=(const Claim&) = delete;

    /// Shows that the process lives, where a beat is due. Returns false if another one has taken
    /// the claim; a file system that does not answer is asked again later.
    bool renew();

  private:
    Claim(const std::filesystem::path& folder, const ClaimTimes& times);
    bool create();
    bool replace();
    void write(const std::filesystem::path& file);

    std::filesystem::path file_;
    ClaimTimes times_;
    LockFile lock_;
    std::string holder_;
    long beats_ = 0;
    std::chrono::steady_clock::time_point last_{};
    bool held_ = false;
};

/// Returns words for the process that holds the folder's claim, as far as can be seen at once: of
/// another machine's claim by its age; nothing if no living one does.
std::optional<std::string> claimed_by(const std::filesystem::path& folder,
                                      const ClaimTimes& times = {});

} // namespace rye::trainer
