// SPDX-License-Identifier: Apache-2.0
#include "data/fit_rigid.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>

namespace rye::trainer {

Rigid<double> fit_rigid(const Columns<double>& from, const Columns<double>& to) {
    return fit_rigid(from, to, VecX<double>::Ones(from.cols()));
}

Rigid<double> fit_rigid(const Columns<double>& from, const Columns<double>& to,
                        const VecX<double>& weights) {
    const Vec3<double> a = from * weights / weights.sum(), b = to * weights / weights.sum();
    const Mat3<double> spread =
        (to.colwise() - b) * weights.asDiagonal() * (from.colwise() - a).transpose();
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(spread, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Mat3<double> u = svd.matrixU();
    const Mat3<double> v = svd.matrixV();
    if ((u * v.transpose()).determinant() < 0) u.col(2) *= -1;
    Rigid<double> motion;
    motion.rotation = u * v.transpose();
    motion.translation = b - motion.rotation * a;
    return motion;
}

} // namespace rye::trainer
