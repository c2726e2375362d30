// SPDX-License-Identifier: Apache-2.0
/// tests/support/locales.hpp: locales of a host program, in whose output 1234.5 is 1.234,5.
#pragma once

#include <clocale>
#include <cstdio>
#include <cstdlib>
#include <locale>
#include <string>

#include "hostile.hpp"

namespace rye::test {

/// The global locale of C++ with a decimal comma and groups of three digits, in this scope.
class GroupingLocale {
  public:
    GroupingLocale() : before_(std::locale::global(std::locale(std::locale(), new Facet))) {}
    GroupingLocale(const GroupingLocale&) = delete;
    GroupingLocale& operator=(const GroupingLocale&) = delete;
    ~GroupingLocale() { std::locale::global(before_); }

  private:
    struct Facet : std::numpunct<char> {
        char do_decimal_point() const override { return ','; }
        char do_thousands_sep() const override { return '.'; }
        std::string do_grouping() const override { return "\3"; }
    };
    std::locale before_;
};

/// The locale de_DE.UTF-8 of C and of C++ in this scope, which localedef makes in a temporary
/// folder. Where it cannot, set() is false and a line of the output says so.
class GermanLocale {
  public:
    GermanLocale() : before_(std::locale()) {
        const std::string path = (folder_.path / "de_DE.UTF-8").string();
        const std::string make = "localedef -i de_DE -f UTF-8 " + path + " > /dev/null 2>&1";
        if (std::system(make.c_str()) == 0) {
            ::setenv("LOCPATH", folder_.path.c_str(), 1);
            set_ = std::setlocale(LC_ALL, "de_DE.UTF-8") != nullptr &&
                   std::string(std::localeconv()->decimal_point) == ",";
        }
        if (set_)
            std::locale::global(std::locale("de_DE.UTF-8"));
        else
            std::printf("not run: a test in de_DE.UTF-8, which localedef did not make\n");
    }
    GermanLocale(const GermanLocale&) = delete;
    GermanLocale& operator=(const GermanLocale&) = delete;
    ~GermanLocale() {
        std::locale::global(before_);
        std::setlocale(LC_ALL, "C");
        ::unsetenv("LOCPATH");
    }
    bool set() const { return set_; }

  private:
    TemporaryFolder folder_;
    std::locale before_;
    bool set_ = false;
};

} // namespace rye::test
