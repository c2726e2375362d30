// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/drive_cache.hpp: the driven Gaussians of both streams, cached between frames.
/// Runs only networks whose driver changed and sums only the points that it influences, in the
/// order of face_gaussians, so every bit is that of drive(). Drivers are compared by bits, without
/// a tolerance.
///
///     changed             networks                            Gaussians
///     nothing             none                                none
///     a gaze              that eye's two                      skin around that eye, that eyeball
///     expression          three of the face, the eye offset   where lambda_exp > 0; eyeballs, if
///                                                             their offset changed
///     head pose           three of the face, the eye offset   all
///     scale               none                                all
///
/// Memory: the rest pose; the outputs of each network; the driven Gaussians in the head and in the
/// world.
#pragma once

#include <concepts>
#include <functional>
#include <optional>
#include <string>

#include <rye/avatar/rest_pose.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/core/bits.hpp>

namespace rye {

/// Effects whose Gaussians depend only on the drivers that a cache compares: the paper's. Effects
/// that read the camera, such as CornealRefraction and Glint, change them with each view.
template <class E>
concept KeptFromFrameToFrame = std::same_as<E, PaperEffects>;

/// Work of the last update.
struct DriveWork {
    Index networks = 0;   ///< networks evaluated
    Index points = 0;     ///< points evaluated, summed over networks
    Index summed = 0;     ///< points of the face summed again
    Index eyes = 0;       ///< eyeballs transformed again
};

/// An avatar's driven Gaussians, of which an update computes again only what changed drivers move.
template <Backend B, Real T>
class DriveCache {
  public:
    /// The avatar, its configuration and roles must outlive the cache. Call reset() when the
    /// avatar's parameters have changed.
    template <EffectSet E>
        requires KeptFromFrameToFrame<E>
    DriveCache(const B& backend, const TwoStream<T, E>& avatar,
               std::reference_wrapper<const AvatarConfig> config,
               std::reference_wrapper<const LandmarkRoles> roles)
        : backend_(backend),
          avatar_(&avatar),
          config_(&config.get()),
          roles_(&roles.get()) {}
    template <EffectSet E>
    DriveCache(const B&, const TwoStream<T, E>&&, std::reference_wrapper<const AvatarConfig>,
               std::reference_wrapper<const LandmarkRoles>) = delete;

    /// Discards all cached values, the rest pose included.
    void reset() {
        rest_.reset();
        last_.reset();
    }

    /// Updates the Gaussians to the drivers.
    const Gaussians<T>& update(const Drivers<T>& drivers) {
        work_ = {};
        changed_.clear();
        if (!rest_) begin();
        const Changes c = changes(drivers);
        if (!c.any()) return world_;
        last_.reset();  // invalid until the update is complete
        code_ = frame_code(*config_, drivers);
        run_networks(c);
        const bool moved_head = c.driver[1] || c.scale;
        if (moved_head) head_ = head_transform(drivers);
        sum_face(c, moved_head);
        place_eyes(c, moved_head, drivers);
        last_ = drivers;
        return world_;
    }

    /// In the world, the face's first.
    const Gaussians<T>& gaussians() const { return world_; }
    /// Columns that the last update changed, ascending.
    const std::vector<Index>& changed() const { return changed_; }
    const DriveWork& work() const { return work_; }
    const RestPose<T>& rest() const { return *rest_; }

    /// Size of all cached data.
    std::size_t bytes() const {
        Index numbers = 0, indices = 0;
        const auto add = [&](const std::string&, const Columns<T>& a) { numbers += a.size(); };
        Gaussians<T>::fields(add, face_);
        Gaussians<T>::fields(add, world_);
        numbers += attributes_.size();
        for (const Field& f : fields_)
            numbers += f.color.size() + f.deform.size() + f.attributes.size();
        if (rest_)
            for (std::size_t d = 0; d < face_drivers; ++d) {
                const auto& m = rest_->moved[d];
                numbers += rest_->lambda(d).size() + m.code.size() + m.feature.size();
                indices += static_cast<Index>(m.points.size());
            }
        for (const auto& r : reached_)
            if (r) {
                indices += static_cast<Index>(r->points.size());
                for (const auto& l : r->listed) indices += static_cast<Index>(l.size());
            }
        return static_cast<std::size_t>(numbers) * sizeof(T) +
               static_cast<std::size_t>(indices) * sizeof(Index);
    }

  private:
    /// Squashed outputs of one driver's networks, a column per influenced point.
    struct Field {
        Columns<T> color, deform, attributes;
    };
    struct Changes {
        std::array<bool, face_drivers> driver{};
        bool scale = false;
        bool any() const { return scale || driver[0] || driver[1] || driver[2] || driver[3]; }
    };

    Changes changes(const Drivers<T>& d) const {
        if (!last_) return {{true, true, true, true}, true};
        return {{!same_bits(d.expression, last_->expression), !same_bits(d.pose, last_->pose),
                 !same_bits(d.gaze[0], last_->gaze[0]), !same_bits(d.gaze[1], last_->gaze[1])},
                !same_bits(d.scale, last_->scale)};
    }

    /// Computes the parts that depend on no driver.
    void begin() {
        const FaceStream<T>& face = avatar_->face;
        const EyeStream<T>& eyes = avatar_->eyes;
        rest_ = rest_pose(backend_, face, *config_, *roles_);
        reached_ = {};
        const Index n = face.position.cols(), all = n + eyes.position.cols();
        face_ = Gaussians<T>(n, config_->channels);
        world_ = Gaussians<T>(all, config_->channels);
        attributes_.resize(8, n);
        world_.feature.rightCols(all - n) = eyes.feature;
        world_.opacity.rightCols(all - n) =
            eyes.opacity_logit.unaryExpr([](const T& v) { return sigmoid(v); });
    }

    void run_networks(const Changes& c) {
        const FaceNetworks<T>& nets = avatar_->face.networks;
        const std::array<const Mlp<T>*, face_drivers> color{
            &nets.exp_color, &nets.pose_color, &nets.gaze_color[0], &nets.gaze_color[1]};
        const std::array<const Mlp<T>*, face_drivers> deform{
            &nets.exp_deform, &nets.pose_deform, &nets.gaze_deform[0], &nets.gaze_deform[1]};
        const std::array<const Mlp<T>*, 2> attributes{&avatar_->face.exp_attributes,
                                                      &avatar_->face.pose_attributes};
        const std::array<const VecX<T>*, face_drivers> codes{&code_.expression, &code_.pose,
                                                             &code_.gaze[0], &code_.gaze[1]};
        const auto run = [&](const Mlp<T>& net, Squash squash, const Columns<T>& input,
                             std::size_t d, Columns<T>& output) {
            output =
                evaluate_field(backend_, rye::Field{net, squash, T(1)}, input, *codes[d], nullptr);
            ++work_.networks;
            work_.points += input.cols();
        };
        for (std::size_t d = 0; d < face_drivers; ++d) {
            if (!c.driver[d]) continue;
            const auto& moved = rest_->moved[d];
            run(*color[d], Squash::none, moved.feature, d, fields_[d].color);
            run(*deform[d], Squash::tanh, moved.code, d, fields_[d].deform);
            if (d < 2)
                run(*attributes[d], Squash::none, moved.feature, d, fields_[d].attributes);
        }
    }

    /// Sums the fields at points where one of them changed, and transforms the result to the world.
    void sum_face(const Changes& c, bool moved_head) {
        const FaceStream<T>& face = avatar_->face;
        const bool attributes = c.driver[0] || c.driver[1];
        const Reached& r = reached_by(c);
        const Columns<T>& x = face.position;
        for_chunks(backend_.threads, static_cast<Index>(r.points.size()), 1024,
                   [&](Index b, Index e, Index) {
                       for (Index k = b; k < e; ++k) {
                           const Index i = r.points[static_cast<std::size_t>(k)];
                           face_.mean.col(i) = x.col(i);
                           face_.feature.col(i).setZero();
                           if (attributes) attributes_.col(i).setZero();
                       }
                   });
        for (std::size_t d = 0; d < face_drivers; ++d) {
            const auto add = [&](double gain, const Columns<T>& output, Columns<T>& out) {
                accumulate_field(backend_,
                                 {T(gain), rest_->lambda(d), rest_->moved[d].points, output},
                                 &r.listed[d], out);
            };
            add(1, fields_[d].color, face_.feature);
            add(config_->deform_scale, fields_[d].deform, face_.mean);
            if (attributes && d < 2)
                add(config_->attribute_scale, fields_[d].attributes, attributes_);
        }
        if (attributes)
            for_chunks(backend_.threads, static_cast<Index>(r.points.size()), 1024,
                       [&](Index b, Index e, Index) {
                           for (Index k = b; k < e; ++k)
                               activate_point(raw_attributes(face),
                                              r.points[static_cast<std::size_t>(k)],
                                              {face_.scale, face_.rotation, face_.opacity},
                                              attributes_);
                       });
        work_.summed = static_cast<Index>(r.points.size());
        if (moved_head) {
            for (Index i = 0; i < rest_->count; ++i) changed_.push_back(i);
        } else {
            changed_ = r.points;
        }
        to_world_part();
    }

    /// Gathers the changed points of the face, transforms them to the world, scatters them back.
    void to_world_part() {
        Gaussians<T>::fields([&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            to = pick_columns(from, changed_);
        }, part_, face_);
        to_world(backend_, head_, part_.scale, part_);
        Gaussians<T>::fields([&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            for (std::size_t k = 0; k < changed_.size(); ++k)
                to.col(changed_[k]) = from.col(static_cast<Index>(k));
        }, world_, part_);
    }

    void place_eyes(const Changes& c, bool moved_head, const Drivers<T>& drivers) {
        const EyeStream<T>& eyes = avatar_->eyes;
        const Index n = rest_->count;
        std::array<bool, 2> moved{c.driver[2] || moved_head, c.driver[3] || moved_head};
        if (c.driver[0] || c.driver[1]) {
            EyeOffsetTrace<T> trace;
            const Columns<T> offset = eye_offset<T>(backend_, eyes.offset, *config_, code_, trace);
            ++work_.networks;
            ++work_.points;
            if (!same_bits(offset, offset_)) moved = {true, true};
            offset_ = offset;
        }
        if (c.scale)
            set_eye_scales(eyes, world_, rest_->count, head_.scale);
        for (Index eye = 0; eye < 2; ++eye) {
            const std::size_t e = static_cast<std::size_t>(eye);
            if (!moved[e]) continue;
            const Index begin = n + eyes.first_point(eye);
            const EyeTransform<T> placed = eye_transform<T>(
                {eyes.centre.col(eye), offset_.col(eye), drivers.gaze[e]},
                {{head_.rotation, head_.translation}, head_.scale});
            place_eye(eyes, eye, placed, begin, world_);
            for (Index i = begin; i < begin + eyes.points_of(eye); ++i) changed_.push_back(i);
            ++work_.eyes;
        }
    }

    /// The points that a set of drivers influences; computed once per set.
    const Reached& reached_by(const Changes& c) {
        std::size_t set = 0;
        for (std::size_t d = 0; d < face_drivers; ++d) set |= std::size_t(c.driver[d]) << d;
        auto& r = reached_[set];
        if (!r) r = reached(*rest_, c.driver);
        return *r;
    }

    B backend_;
    const TwoStream<T>* avatar_;
    const AvatarConfig* config_;
    const LandmarkRoles* roles_;
    std::optional<RestPose<T>> rest_;
    std::array<std::optional<Reached>, 16> reached_;
    std::optional<Drivers<T>> last_;
    FrameCode<T> code_;
    HeadTransform<T> head_;
    std::array<Field, face_drivers> fields_;
    Columns<T> attributes_;     ///< summed steps, 8 x N
    Columns<T> offset_;         ///< of the eyes, 3 x 2
    Gaussians<T> face_;         ///< head frame
    Gaussians<T> world_, part_;
    std::vector<Index> changed_;
    DriveWork work_;
};

} // namespace rye
