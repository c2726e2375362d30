// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/kept_highlights.hpp: highlights of an avatar's eyes, which change with the
/// camera: the colours before them are kept, so that another view evaluates no network.
#pragma once

#include <rye/avatar/eye_stream.hpp>

namespace rye::detail {

/// Colours of both eyes before their highlights. Empty, and nothing is done, for an avatar without
/// lights.
template <class T, EffectSet E>
class KeptHighlights {
  public:
    /// Returns true if the eyes have lights.
    static bool any(const EyeStream<T, E>& eyes) {
        if constexpr (has_effect<E, Glint>) return eyes.optics.lights() > 0;
        return false;
    }

    /// Adds an eye's highlights to its columns of `feature`, of which `begin` is the first of both
    /// eyes'. `fresh`: they have been written since; else they begin with what they were then.
    template <Backend B>
    void add([[maybe_unused]] const B& backend, const EyeStream<T, E>& eyes,
             [[maybe_unused]] const ViewedEye<T>& viewed, [[maybe_unused]] bool fresh,
             [[maybe_unused]] Columns<T>& feature, [[maybe_unused]] Index begin) {
        if (!any(eyes)) return;
        if constexpr (has_effect<E, Glint>) {
            const Index first = eyes.first_point(static_cast<Index>(viewed.eye));
            plain_.resize(feature.rows(), eyes.position.cols());
            auto own = feature.middleCols(begin + first, viewed.count);
            if (fresh)
                plain_.middleCols(first, viewed.count) = own;
            else
                own = plain_.middleCols(first, viewed.count);
            require_camera(viewed.camera);
            check_optics(eyes.optics);
            add_highlights(backend, eyes.optics, viewed, see_lights(eyes.optics, viewed),
                           viewed.points, feature.rows(), own.data());
        }
    }
    /// Returns how many numbers are kept.
    Index size() const { return plain_.size(); }

  private:
    Columns<T> plain_; ///< C x P
};

} // namespace rye::detail
