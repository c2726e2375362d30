// SPDX-License-Identifier: Apache-2.0
/// tests/hard_cases/report.hpp: required and reached accuracy of a hard case. A row is one law of
/// one entry of the catalogue, for one kind of number; a row of a textbook formula must fail the
/// law that rye's formula satisfies, which shows that the law is meaningful.
#pragma once

#include <algorithm>
#include <cmath>
#include <string>
#include <string_view>
#include <vector>

#include <rye/backend/lanes.hpp>
#include <rye/core/random.hpp>

#include "../support/flush_to_zero.hpp"

namespace rye::hard {

struct Row {
    std::string id;     ///< of the entry: "A1"
    std::string kind;   ///< "float", "float lanes", "float, scalar backend", ...
    std::string inputs; ///< inputs, or in a textbook row the formula
    double demanded;    ///< the largest error allowed; < 0: a fact that must hold
    double reached;     ///< the largest error; of a fact 0 if it holds, else 1
    bool textbook;

    bool within() const { return demanded < 0 ? reached == 0 : reached <= demanded; } // NaN fails
    bool passed() const { return within() != textbook; }
};

class Report {
  public:
    void at_most(const char* id, std::string kind, std::string inputs, double demanded,
                 double reached) {
        rows.push_back({id, std::move(kind), std::move(inputs), demanded, reached, false});
    }
    void holds(const char* id, std::string kind, std::string inputs, bool fact) {
        rows.push_back({id, std::move(kind), std::move(inputs), -1, fact ? 0.0 : 1.0, false});
    }
    /// The textbook formula, measured like rye's: it must exceed the requirement.
    void textbook(const char* id, std::string kind, std::string formula, double demanded,
                  double reached) {
        rows.push_back({id, std::move(kind), std::move(formula), demanded, reached, true});
    }
    void textbook_fails(const char* id, std::string kind, std::string formula, bool fact) {
        rows.push_back({id, std::move(kind), std::move(formula), -1, fact ? 0.0 : 1.0, true});
    }
    std::vector<Row> rows;
};

/// An entry of the catalogue, and where it is tested if not in this program; a note that begins
/// with "absent" names what does not exist.
struct Entry {
    std::string_view id, title, elsewhere;
};
const std::vector<Entry>& catalogue();

// One function per group of entries, in the file of the same name.
void determinants(Report&);
void cameras(Report&);
void blending(Report&);
void images(Report&);
void tiling(Report&);
void rotations(Report&);
void rigs(Report&);
void colours(Report&);
void networks(Report&);
void losses(Report&);
void surfaces(Report&);
void duals(Report&);
void machines(Report&);
void files(Report&);

template <class T>
using Lanes = xsimd::batch<T, DefaultArch>;

template <class S>
std::string kind_of() {
    const std::string real = sizeof(real_t<S>) == 4 ? "float" : "double";
    return real + (std::is_floating_point_v<S> ? "" : " lanes");
}

/// f.template operator()<S>() for plain numbers and for lanes of both widths.
template <class F>
void every_scalar(F&& f) {
    f.template operator()<float>();
    f.template operator()<double>();
    f.template operator()<Lanes<float>>();
    f.template operator()<Lanes<double>>();
}

/// The number in the first lane.
template <class S>
double first(const S& x) {
    if constexpr (std::is_floating_point_v<S>)
        return static_cast<double>(x);
    else
        return static_cast<double>(x.get(0));
}
inline bool truth(bool b) { return b; }
template <class M>
    requires(!std::is_same_v<M, bool>)
bool truth(const M& mask) { return xsimd::all(mask); }

/// Raises `worst` to x if x is larger; NaN is the largest.
inline void worsen(double& worst, double x) {
    if (!(x <= worst) && !std::isnan(worst)) worst = x;
}

template <class S>
inline constexpr double unit = sizeof(real_t<S>) == 4 ? 0x1p-24 : 0x1p-53;

} // namespace rye::hard
