// SPDX-License-Identifier: Apache-2.0
#include <rye/avatar/field.hpp>
#include <rye/backend/scalar.hpp>
#include <rye/core/thread_pool.hpp>

#include <doctest/doctest.h>

#include "../support/random.hpp"

using namespace rye;

TEST_CASE("influenced: every point, none, or some, of more points than a chunk") {
    ThreadPool pool(3);
    const ScalarBackend backend{pool.threads()};
    constexpr Index n = 7000;
    const auto check = [&](const Columns<float>& lambda) {
        std::vector<Index> expected;
        for (Index i = 0; i < n; ++i)
            if (lambda(0, i) > 0) expected.push_back(i);
        CHECK(detail::influenced(backend, lambda) == expected);
    };
    check(Columns<float>::Ones(1, n));
    check(Columns<float>::Zero(1, n));
    check(random_columns<float>(1, n, 1));
    Columns<float> late = Columns<float>::Zero(1, n);
    late.rightCols(3000).setOnes();
    check(late);
    CHECK(detail::influenced(backend, Columns<float>(1, 0)).empty());
}
