// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/kept_view.hpp: the colours by the view (avatar/view_color.hpp) of Gaussians that
/// a DriveCache drives again. Does and keeps nothing for an avatar without them.
#pragma once

#include <vector>

#include <rye/avatar/two_stream.hpp>

namespace rye::detail {

/// The head of the last frame as its camera sees it.
template <class T, EffectSet E>
class KeptView {
  public:
    /// Takes a frame's camera and head, if the avatar's effects have one.
    template <class... Head>
    void see([[maybe_unused]] const TwoStream<T, E>& avatar,
             [[maybe_unused]] const Drivers<T, E>& drivers, [[maybe_unused]] const Head&... head) {
        if constexpr (has_effect<E, ViewColor>)
            if (avatar.has_view_color()) seen_ = seen_head_of(drivers, head...);
    }
    /// Adds their colours to these columns of the face, gathered in `part`.
    template <Backend B>
    void tint_face([[maybe_unused]] const B& backend,
                   [[maybe_unused]] const TwoStream<T, E>& avatar,
                   [[maybe_unused]] const std::vector<Index>& columns,
                   [[maybe_unused]] Gaussians<T>& part) const {
        if constexpr (has_effect<E, ViewColor>)
            if (const Columns<T>& c = avatar.view_color.face; avatar.has_view_color())
                add_view_color(backend, {c.data(), c.rows(), columns.data()}, seen_,
                               {0, part.count()}, part);
    }
    /// Adds an eye's colours to its columns of a cloud.
    template <Backend B>
    void tint_eye([[maybe_unused]] const B& backend, [[maybe_unused]] const TwoStream<T, E>& avatar,
                  [[maybe_unused]] Index eye, [[maybe_unused]] const ColumnRange& range,
                  [[maybe_unused]] Gaussians<T>& world) const {
        if constexpr (has_effect<E, ViewColor>)
            if (const Columns<T>& c = avatar.view_color.eyes; avatar.has_view_color())
                add_view_color(
                    backend,
                    {c.data() + c.rows() * avatar.eyes.first_point(eye), c.rows(), nullptr}, seen_,
                    range, world);
    }

  private:
    [[no_unique_address]] Slot<E, ViewColor, SeenHead<T>> seen_;
};

} // namespace rye::detail
