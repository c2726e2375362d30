// SPDX-License-Identifier: Apache-2.0
/// data/folder_lock.hpp: lock of a folder that one process at a time may write to, with words that
/// tell the others who holds it. The system releases it when the process ends, for any reason; the
/// file stays.
#pragma once

#include <filesystem>
#include <string>

#include "data/system.hpp"

namespace rye::trainer {

/// Options of a FolderLock.
struct LockOptions {
    std::string holder;          ///< name of the work there: "rye train"
    double patience = 0;         ///< longest wait for another process [s]
    bool children_too = false;   ///< true: children hold it until they end
};

/// Lock of a folder, held until the object or the process ends. Holds nothing on a file system
/// without locks.
class FolderLock {
  public:
    /// Throws an Error if another process holds it, with its number, its host and the time since.
    FolderLock(const std::filesystem::path& folder, const LockOptions& options);

  private:
    LockFile file_;
};

} // namespace rye::trainer
