// SPDX-License-Identifier: Apache-2.0
// A cloud moved by a similarity: colours turn with it at every degree, covariances follow.
#include <rye/gaussian/move_cloud.hpp>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/clouds.hpp"

using namespace rye;
using test::cloud_of, test::largest;

namespace {

Mat3<double> some_rotation(std::uint64_t seed) {
    const Random random{11, seed};
    return quat_matrix(quat_normalized(
        Quat<double>(random.normal(0), random.normal(1), random.normal(2), random.normal(3))));
}

Mat3<double> covariance(const GaussianCloud<double>& c, Index i) {
    const Vec3<double> s = c.log_scale.col(i).array().exp().square();
    const Mat3<double> r = quat_matrix(quat_normalized<double>(c.rotation.col(i)));
    return r * s.asDiagonal() * r.transpose();
}

} // namespace

TEST_CASE("move_cloud: harmonics turned by a rotation have its colours at turned directions") {
    for (int degree = 1; degree <= 4; ++degree) {
        const Mat3<double> r = some_rotation(static_cast<std::uint64_t>(degree));
        const Columns<double> d = harmonics_rotation(r, degree);
        CHECK(largest(d.transpose() * d - Columns<double>::Identity(d.rows(), d.cols())) <= 1e-13);
        const Random random{5, 2};
        for (std::uint64_t k = 0; k < 60; k += 3) {
            const Vec3<double> p = normalized(
                Vec3<double>(random.normal(k), random.normal(k + 1), random.normal(k + 2)));
            const VecX<double> here = sh_basis<double>(degree, p).tail(d.rows());
            const VecX<double> there = sh_basis<double>(degree, Vec3<double>(r * p)).tail(d.rows());
            CHECK(largest(there - d * here) <= 1e-13);
        }
    }
}

TEST_CASE("move_cloud: means, covariances and colours follow a similarity") {
    for (int degree = 0; degree <= 4; ++degree) {
        const auto before = cloud_of(30, degree);
        auto after = before;
        const Similarity s{1.7, some_rotation(9), Vec3<double>(1, -2, 3)};
        detail::move_cloud(after, s);
        const Index more = before.sh_rest.rows() / 3;
        for (Index i = 0; i < before.count(); ++i) {
            CHECK(largest(after.mean.col(i) -
                          (s.scale * s.rotation * before.mean.col(i) + s.translation)) <= 1e-12);
            const Mat3<double> m = s.scale * s.rotation;
            const Mat3<double> expected = m * covariance(before, i) * m.transpose();
            CHECK(largest(covariance(after, i) - expected) <= 1e-12 * largest(expected));
            const Vec3<double> p = normalized(Vec3<double>(before.mean.col(i)));
            const VecX<double> here = sh_basis<double>(degree, p).tail(more);
            const VecX<double> there =
                sh_basis<double>(degree, Vec3<double>(s.rotation * p)).tail(more);
            for (Index c = 0; c < 3; ++c)
                CHECK(after.sh_rest.col(i).segment(c * more, more).dot(there) ==
                      doctest::Approx(before.sh_rest.col(i).segment(c * more, more).dot(here)));
        }
        CHECK(after.sh_constant == before.sh_constant);
        CHECK(after.logit_opacity == before.logit_opacity);
    }
}

TEST_CASE("move_cloud: no motion changes nothing but the length of quaternions") {
    const auto before = cloud_of(10, 3);
    auto after = before;
    detail::move_cloud(after, {});
    CHECK(after.mean == before.mean);
    CHECK(after.log_scale == before.log_scale);
    CHECK(after.sh_rest == before.sh_rest);
    for (Index i = 0; i < 10; ++i)
        CHECK(largest(after.rotation.col(i) - before.rotation.col(i).normalized()) <= 1e-15);
}
