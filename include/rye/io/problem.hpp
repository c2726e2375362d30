// SPDX-License-Identifier: Apache-2.0
/// rye/io/problem.hpp: faults of a capture, listed or thrown.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include <rye/core/error.hpp>

namespace rye {

/// A fault of a capture, in one sentence that names file, field and value.
struct Problem {
    enum class Severity { warning, error };
    Severity severity = Severity::error;
    std::string message;
};

/// Destination of faults: a list, or else an exception.
class Faults {
  public:
    explicit Faults(std::vector<Problem>* list) : list_(list) {}

    void error(const std::string& message) {
        if (!list_) throw Error(message);
        list_->push_back({Problem::Severity::error, message});
    }
    void warning(const std::string& message) {
        if (list_) list_->push_back({Problem::Severity::warning, message});
    }
    /// Returns true if f() did not throw an Error.
    template <class F>
    bool attempt(F&& f) {
        try {
            f();
            return true;
        } catch (const Error& e) {
            error(e.what());
        } catch (const std::filesystem::filesystem_error& e) {
            error(e.path1().string() + ": " + e.code().message());
        }
        return false;
    }

  private:
    std::vector<Problem>* list_;
};

} // namespace rye
