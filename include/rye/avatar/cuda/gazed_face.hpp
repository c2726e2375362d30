// SPDX-License-Identifier: Apache-2.0
/// rye/avatar/cuda/gazed_face.hpp: the points of a face that gazes move, in device memory, and
/// their features and means where only the networks of the gazes were run again: what the others
/// gave is still there, in the order of their lists, so that a point's sum is made anew, in the
/// order of FieldAdd and with its bits.
#pragma once

#include <rye/avatar/cuda/face_points.hpp>
#include <rye/avatar/cuda/field.hpp>
#include <rye/backend/cuda/unrolled.hpp>

namespace rye::detail {

/// The points that the gaze of either eye moves.
struct GazedPoints {
    DeviceInfluenced of[2]; ///< by a gaze each; the room is 0 where there is none

    /// Places of points: some have none.
    RYE_HD Index count() const { return of[0].room + of[1].room; }
    /// The point of a place, -1 for none. A point that both gazes move has one place.
    RYE_DEVICE Index at(Index place) const {
        const int gaze = place < of[0].room ? 0 : 1;
        const auto k = static_cast<std::uint32_t>(gaze == 0 ? place : place - of[0].room);
        const DeviceInfluenced& set = of[gaze];
        if (k >= set.points.among(static_cast<std::uint32_t>(set.room))) return -1;
        const auto point = static_cast<Index>(set.points.column(k));
        return gaze == 1 && of[0].lambda[point] > 0.0F ? -1 : point;
    }
};

/// The sum of all fields of a kind at a point, in their order.
template <int fields>
struct FieldsSum {
    const float* before; ///< what they are added to, rows x N, or null
    Index rows;
    DeviceFieldOutputs of[static_cast<std::size_t>(fields)];

    /// n of its rows.
    template <int n>
    RYE_DEVICE void at(Index point, Index row, float* sum) const {
        for (int r = 0; r < n; ++r)
            sum[r] = before != nullptr ? before[point * rows + row + r] : 0.0F;
        repeated<fields>([&](auto k) { of[k].template add<n>(point, row, sum); });
    }
};

/// Sets number i of the features, by places and rows.
template <int fields>
struct GazedFeature {
    static constexpr const char* name = "face by a gaze, features";
    GazedPoints points;
    FieldsSum<fields> sum;
    float* feature; ///< rows x N

    RYE_DEVICE void operator()(Index i) const {
        const auto rows = static_cast<std::uint32_t>(sum.rows),
                   number = static_cast<std::uint32_t>(i); // DeviceMlp: 2^32 numbers at most
        const Index point = points.at(static_cast<Index>(number / rows)),
                    row = static_cast<Index>(number % rows);
        if (point < 0) return;
        float own[1];
        sum.template at<1>(point, row, own);
        feature[point * sum.rows + row] = own[0];
    }
};

/// Sets the mean of a place's point, in the world.
template <EffectSet E, int fields>
struct GazedMean {
    static constexpr const char* name = "face by a gaze, means";
    GazedPoints points;
    FieldsSum<fields> sum;
    float* mean; ///< 3 x N
    const DeviceFrameState* frame;

    RYE_DEVICE void operator()(Index place) const {
        const Index point = points.at(place);
        if (point < 0) return;
        float x[3];
        sum.template at<3>(point, 0, x);
        put_column<3>(mean_of_face<E>(frame, column3(x, 0)), mean, point);
    }
};

} // namespace rye::detail
