// SPDX-License-Identifier: Apache-2.0
/// data/folder_lock.hpp: a lock of a folder that one process at a time may write to, with the words
/// for the others of who has it. The system gives it back when the process ends, whatever ended it;
/// the file stays.
#pragma once

#include <filesystem>
#include <string>

namespace rye::trainer {

/// How a folder is locked.
struct LockOptions {
    std::string holder;          ///< what works there: "rye train"
    double patience = 0;         ///< how long another process is waited for [s]
    bool children_too = false;   ///< whether children hold it until they have ended
};

/// A lock of a folder, held until this process has ended, or the object. On a file system without
/// locks nothing is held.
class FolderLock {
  public:
    /// Throws Error where another process holds it: its number, its host and since when.
    FolderLock(const std::filesystem::path& folder, const LockOptions& options);
    ~FolderLock();
    FolderLock(const FolderLock&) = delete;
    FolderLock& operator=(const FolderLock&) = delete;

  private:
    int file_ = -1;
};

} // namespace rye::trainer
