// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/drive_cache.hpp: the driven Gaussians of both streams, cached between frames.
/// Runs only networks whose driver changed and sums only the points that it influences, in the
/// order of face_gaussians, so every bit is that of drive(). Drivers are compared by bits, without
/// a tolerance; gazes as optical axes, after kappa.
///
///     changed             networks                            Gaussians
///     nothing             none                                none
///     a gaze              that eye's two, that eye's features skin around that eye, that eyeball
///     expression          three of the face, the eye offset,  where lambda_exp > 0; eyeballs, if
///                         both eyes' features                 their offset or features changed
///     head pose           three of the face, the eye offset,  all; light, if the rotation changed
///                         both eyes' features
///     scale               none                                all
///     the camera's place  none                                highlights' colours; refracted eyes;
///                                                             all, if their colours depend on it
///     a pupil             none                                that eyeball
///     a lid, by any       none                                that eyeball's colours, if shadowed
///
/// Features that an avatar lacks (driven eyes, light by the head's rotation, highlights,
/// refraction, shadows of lids, any effect that its list does not name) are not computed.
/// Memory: the rest pose; each network's outputs; the driven Gaussians in head and world; light's
/// gains; the eyes' colours before shadows and highlights, their points as refracted.
#pragma once

#include <functional>
#include <optional>
#include <string>

#include <rye/avatar/rest_pose.hpp>
#include <rye/avatar/two_stream.hpp>
#include <rye/core/bits.hpp>
#include <rye/interactive/drive_work.hpp>
#include <rye/interactive/kept_highlights.hpp>
#include <rye/interactive/kept_view.hpp>

namespace rye {

/// Cache of an avatar's driven Gaussians, which recomputes only those that changed drivers move.
template <Backend B, Real T, EffectSet E = PaperEffects>
    requires KeptFromFrameToFrame<E>
class DriveCache {
  public:
    /// Type of the avatars.
    using Avatar = TwoStream<T, E>;

    /// The avatar, its configuration and roles must outlive the cache. Call reset() when the
    /// avatar's parameters have changed.
    DriveCache(const B& backend, const Avatar& avatar,
               std::reference_wrapper<const AvatarConfig> config,
               std::reference_wrapper<const LandmarkRoles> roles)
        : backend_(backend),
          avatar_(&avatar),
          config_(&config.get()),
          roles_(&roles.get()) {}
    DriveCache(const B&, const Avatar&&, std::reference_wrapper<const AvatarConfig>,
               std::reference_wrapper<const LandmarkRoles>) = delete;

    /// Discards all cached values, the rest pose included.
    void reset() {
        rest_.reset();
        last_.reset();
    }

    /// Updates the Gaussians to the drivers, whose gazes are as for drive().
    const Gaussians<T>& update(const Drivers<T, E>& drivers) {
        work_ = {};
        changed_.clear();
        if (!rest_) begin();
        const OpticalDrivers<T, E> optical = optical_drivers(avatar_->eyes, drivers);
        const Changes c = changes(optical.drivers);
        if (!c.any()) return world_;
        last_.reset();  // invalid until the update is complete
        code_ = frame_code(*config_, optical);
        run_networks(c);
        if constexpr (has_effect<E, HeadPose>)
            if (c.moves_all()) head_ = head_transform(optical.drivers);
        light(c, optical.drivers);
        with_head([&](const auto&... head) { view_.see(*avatar_, optical.drivers, head...); });
        sum_face(c);
        place_eyes(c, optical);
        last_ = optical.drivers;
        return world_;
    }

    /// Returns the Gaussians in the world, the face's first.
    const Gaussians<T>& gaussians() const { return world_; }
    /// Returns the columns that the last update changed, ascending.
    const std::vector<Index>& changed() const { return changed_; }
    const DriveWork& work() const { return work_; }
    const RestPose<T, E>& rest() const { return *rest_; }

    /// Returns the size of all cached data [bytes].
    std::size_t bytes() const {
        Index numbers = attributes_.size() + gain_.size() + highlights_.size(), indices = 0;
        if constexpr (has_effect<E, Pupil>) numbers += pupils_.points.size();
        const auto add = [&](const std::string&, const Columns<T>& a) { numbers += a.size(); };
        for (const Gaussians<T>* g : {&face_, &world_}) Gaussians<T>::fields(add, *g);
        for (const Outputs& f : outputs_)
            numbers += f.color.size() + f.deform.size() + f.attributes.size();
        if (rest_) {
            const auto [n, i] = rest_->sizes();
            numbers += n, indices += i;
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
    static constexpr bool has_attributes = has_effect<E, ReadsFaceRamp>;
    using Highlights = detail::KeptHighlights<T, E>;

    /// Squashed outputs of one driver's networks, a column per influenced point.
    struct Outputs {
        Columns<T> color, deform, attributes;
    };
    using Changes = detail::DriveChanges;

    Changes changes(const Drivers<T, E>& d) const {
        const bool lit = has_light();
        if (!last_) return {true, {true, true, true, true}, true, lit};
        Changes c;
        if constexpr (has_effect<E, ReadsExpression>)
            c.driver[0] = !same_bits(d.expression, last_->expression);
        if constexpr (has_effect<E, ReadsHeadPose>) {
            c.driver[1] = !same_bits(d.pose, last_->pose);
            c.light = lit && !same_bits(Vec3<T>(d.pose.template head<3>()),
                                        Vec3<T>(last_->pose.template head<3>()));
        }
        for_eyes([&]<std::size_t eye>() {
            if constexpr (eye_turns<E, eye>)
                c.driver[2 + eye] =
                    !same_bits(of_eye<eye>(d.gaze), of_eye<eye>(last_->gaze));
            if constexpr (pupil_moves<E, eye>)
                c.pupil[eye] = !same_bits(of_eye<eye>(d.pupil), of_eye<eye>(last_->pupil));
        });
        if constexpr (has_effect<E, HeadPose>) c.scale = !same_bits(d.scale, last_->scale);
        if constexpr (has_effect<E, ReadsCamera>) {
            const bool other = !same_bits(d.camera, last_->camera);
            c.tint = other && avatar_->has_view_color();
            c.view = c.tint || (other && avatar_->eyes.optics.sees_cornea());
            c.bent = other && avatar_->eyes.optics.refracts();
        }
        return c;
    }

    bool has_light() const {
        if constexpr (has_effect<E, HeadShading>) return avatar_->shading.any();
        return false;
    }

    /// Computes the parts that depend on no driver.
    void begin() {
        const FaceStream<T, E>& face = avatar_->face;
        const EyeStream<T, E>& eyes = avatar_->eyes;
        rest_ = rest_pose(backend_, face, *config_, *roles_);
        reached_ = {};
        const Index n = face.position.cols(), all = n + eyes.position.cols();
        face_ = Gaussians<T>(n, config_->channels);
        world_ = Gaussians<T>(all, config_->channels);
        face_.mean = face.position;
        if constexpr (face_rests<E>)
            face_.feature = face.rest_color;
        else
            face_.feature.setZero();
        const detail::DrawnAttributes<T> drawn{face_.scale, face_.rotation, face_.opacity};
        if constexpr (has_attributes) {
            attributes_.setZero(8, n);
            detail::activate_into(backend_, detail::raw_attributes(face), drawn, attributes_);
        } else {
            detail::activate_into(backend_, detail::raw_attributes(face), drawn);
        }
    }

    void run_networks(const Changes& c) {
        const auto run = [&](const auto& net, Squash squash, const Columns<T>& input,
                             const VecX<T>& code, Columns<T>& output) {
            output =
                evaluate_field(backend_, rye::Field{net, squash, T(1)}, input, code, nullptr);
            ++work_.networks;
            work_.points += input.cols();
        };
        const FaceStream<T, E>& face = avatar_->face;
        for_face_fields<E>([&](auto by) {
            if (!c.driver[by.driver]) return;
            const auto& moved = rest_->moved[by.driver];
            Outputs& to = outputs_[by.driver];
            const VecX<T>& code = by.code(code_);
            run(by.color(face.networks), Squash::none, moved.feature, code, to.color);
            run(by.deform(face.networks), Squash::tanh, moved.code, code, to.deform);
            if constexpr (by.attributes)
                run(by.attribute(face), Squash::none, moved.feature, code, to.attributes);
        });
    }

    /// Computes the light's gains from the head's rotation.
    void light(const Changes& c, [[maybe_unused]] const Drivers<T, E>& drivers) {
        if (!c.light) return;
        if constexpr (has_effect<E, HeadShading>)
            detail::shading_gain(backend_, avatar_->shading,
                                 Vec3<T>(drivers.pose.template head<3>()), gain_);
        work_.lit = gain_.cols();
    }

    /// Sums the fields at points where one of them changed, and transforms the result to the world.
    void sum_face(const Changes& c) {
        const FaceStream<T, E>& face = avatar_->face;
        const bool attributes = has_attributes && c.attributes();
        const detail::Reached& r = reached_by(c);
        const auto for_points = [&](const auto& f) {
            for_chunks(backend_.threads, static_cast<Index>(r.points.size()), 1024,
                       [&](Index b, Index e, Index) {
                           for (Index k = b; k < e; ++k) f(r.points[static_cast<std::size_t>(k)]);
                       });
        };
        for_points([&](Index i) {
            face_.mean.col(i) = face.position.col(i);
            if constexpr (face_rests<E>)
                face_.feature.col(i) = face.rest_color.col(i);
            else
                face_.feature.col(i).setZero();
            if (attributes) attributes_.col(i).setZero();
        });
        for_face_fields<E>([&](auto by) {
            const Outputs& from = outputs_[by.driver];
            const auto add = [&](double gain, const Columns<T>& output, Columns<T>& out) {
                accumulate_field(backend_,
                                 {T(gain), by.influence(rest_->weights),
                                  rest_->moved[by.driver].points, output},
                                 &r.listed[by.driver], out);
            };
            add(1, from.color, face_.feature);
            add(config_->deform_scale, from.deform, face_.mean);
            if constexpr (by.attributes)
                if (attributes) add(config_->attribute_scale, from.attributes, attributes_);
        });
        if constexpr (has_attributes)
            if (attributes)
                for_points([&](Index i) {
                    const detail::DrawnAttributes<T> to{face_.scale, face_.rotation, face_.opacity};
                    detail::activate_point(detail::raw_attributes(face), i, to, attributes_);
                });
        work_.summed = static_cast<Index>(r.points.size());
        if (c.moves_all() || c.tint)
            for (Index i = 0; i < rest_->count; ++i) changed_.push_back(i);
        else
            changed_ = r.points;
        to_world_part();
    }

    /// Gathers the changed points of the face, transforms them to the world and into the light,
    /// scatters them back.
    void to_world_part() {
        Gaussians<T>::fields([&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            to = pick_columns(from, changed_);
        }, part_, face_);
        if constexpr (has_effect<E, HeadPose>) to_world(backend_, head_, part_.scale, part_);
        view_.tint_face(backend_, *avatar_, changed_, part_);
        if (has_light())
            for (std::size_t k = 0; k < changed_.size(); ++k)
                shade_point(gain_, changed_[k], part_.feature, static_cast<Index>(k));
        Gaussians<T>::fields([&](const std::string&, Columns<T>& to, const Columns<T>& from) {
            for (std::size_t k = 0; k < changed_.size(); ++k)
                to.col(changed_[k]) = from.col(static_cast<Index>(k));
        }, world_, part_);
    }

    /// Calls f(head...) with the head's transform, if the avatar has one.
    template <class F>
    decltype(auto) with_head(F&& f) const {
        if constexpr (has_effect<E, HeadPose>)
            return f(head_);
        else
            return f();
    }

    void place_eyes(const Changes& c, const OpticalDrivers<T, E>& drivers) {
        const EyeStream<T, E>& eyes = avatar_->eyes;
        std::array<bool, 2> moved{c.moves(0), c.moves(1)};
        if (c.first || c.pupil[0] || c.pupil[1])
            detail::set_pupils(backend_, eyes, drivers.drivers, pupils_);
        const T* const points = detail::moved_points(eyes, pupils_).data();
        Columns<T> centre = eyes.centre;
        if constexpr (has_effect<E, EyeOffset>) {
            if (c.driver[0] || c.driver[1]) {
                EyeOffsetTrace<T> trace;
                centre += eye_offset<T>(backend_, eyes.offset, *config_, code_, trace);
                ++work_.networks, ++work_.points;
            } else {
                centre = centre_;
            }
        }
        if (!same_bits(centre, centre_)) moved = {true, true};
        centre_ = centre;
        const detail::GaussianArrays<T> to =
            detail::columns_from(arrays_of(world_), {rest_->count, eyes.position.cols()});
        for_eyes([&]<std::size_t eye>() {
            constexpr Index e = static_cast<Index>(eye);
            const Index first = eyes.first_point(e), n = eyes.points_of(e);
            const detail::EyeArrays<const T> raw = arrays_of(eyes).from(first);
            const detail::GaussianArrays<T> own = detail::columns_from(to, {first, n});
            if (!moved[eye]) return;
            with_head([&](const auto&... head) {
                if (c.first || c.scale || c.pupil[eye]) {
                    for_each(backend_, n, detail::SizeEyePoint<T, E>{
                                              raw, own, detail::head_address<T>(head...)});
                    detail::stretch_eye(backend_, eyes, e, pupils_, own.scale.data);
                }
                placed_[eye] =
                    detail::placed_eye<eye>(eyes, Vec3<T>(centre_.col(e)), drivers, head...);
            });
            const T* const seen = highlights_.see(backend_, eyes, eye, drivers.drivers,
                                                  placed_[eye], points + 3 * first);
            for_each(backend_, n, detail::PlaceEyePoint<T>{raw, seen, own, &placed_[eye]});
            ++work_.eyes;
        });
        const std::array<bool, 2> coloured = write_eye_features(c, drivers, moved);
        for (Index e = 0, i = rest_->count; e < 2; ++e)
            for (const Index end = i + eyes.points_of(e); i < end; ++i)
                if (moved[std::size_t(e)] || coloured[std::size_t(e)]) changed_.push_back(i);
    }

    /// Writes the features of eyes whose drivers, light, lids or highlights changed; returns them.
    std::array<bool, 2> write_eye_features(const Changes& c, const OpticalDrivers<T, E>& drivers,
                                           const std::array<bool, 2>& moved) {
        const EyeStream<T, E>& eyes = avatar_->eyes;
        const bool kept = Highlights::any(eyes);
        const std::array<bool, 2> lid =
            highlights_.follow(eyes, face_.mean, avatar_->face.position, centre_, drivers);
        std::array<bool, 2> which{}, written{}, driven{};
        for (std::size_t eye = 0; eye < 2; ++eye) {
            const bool gaze = c.driver[2 + eye], relit = kept && (c.view || moved[eye] || lid[eye]);
            driven[eye] = detail::drives_features<EyeAppearanceOf<E>>(eyes.appearance(), eye);
            const bool tinted = avatar_->has_view_color() && (c.view || moved[eye]);
            written[eye] = c.first || ((c.light || tinted) && !kept) ||
                           (driven[eye] && (c.attributes() || gaze)) ||
                           (GazeMechanismOf<E>::changes_features && gaze);
            which[eye] = written[eye] || c.light || tinted || relit;
        }
        if constexpr (!detail::eyes_apart<E>)
            if (written[0] || written[1] ||
                ((driven[0] || driven[1]) && (c.driver[2] || c.driver[3])))
                which = written = {true, true};
        if (written[0] || written[1])
            eye_features(backend_, eyes, {*config_, drivers, code_}, written, rest_->count, world_);
        for (Index eye = 0; eye < 2; ++eye) {
            const std::size_t e = static_cast<std::size_t>(eye);
            if (!which[e]) continue;
            const Index first = eyes.first_point(eye), begin = rest_->count + first,
                        n = eyes.points_of(eye);
            highlights_.add(backend_, eyes, e, drivers.drivers, placed_[e],
                            detail::moved_points(eyes, pupils_).data() + 3 * first, written[e],
                            world_.feature, rest_->count);
            view_.tint_eye(backend_, *avatar_, eye, {begin, n}, world_);
            if (has_light())
                for (Index i = begin; i < begin + n; ++i)
                    shade_point(gain_, rest_->count + eye, world_.feature, i);
            if (driven[e] && written[e]) ++work_.networks, work_.points += n;
        }
        return which;
    }

    /// Returns the points that a set of drivers influences; computed once per set.
    const detail::Reached& reached_by(const Changes& c) {
        std::size_t set = 0;
        for (std::size_t d = 0; d < face_drivers; ++d) set |= std::size_t(c.driver[d]) << d;
        auto& r = reached_[set];
        if (!r) r = reached(*rest_, c.driver);
        return *r;
    }

    B backend_;
    const Avatar* avatar_;
    const AvatarConfig* config_;
    const LandmarkRoles* roles_;
    std::optional<RestPose<T, E>> rest_;
    std::array<std::optional<detail::Reached>, 16> reached_;
    std::optional<Drivers<T, E>> last_;
    FrameCode<T, E> code_;
    [[no_unique_address]] detail::HeadSlot<T, E> head_;
    detail::KeptView<T, E> view_;
    std::array<Outputs, face_drivers> outputs_;
    Columns<T> attributes_;     ///< summed steps, 8 x N
    Columns<T> gain_;           ///< of the light, 3 x (N + 2)
    Columns<T> centre_;         ///< of the eyes in the head frame, 3 x 2
    std::array<EyeTransform<T>, 2> placed_;
    [[no_unique_address]] detail::Slot<E, Pupil, detail::FramePupils<T>> pupils_;
    Highlights highlights_;
    Gaussians<T> face_;         ///< head frame
    Gaussians<T> world_, part_;
    std::vector<Index> changed_;
    DriveWork work_;
};

} // namespace rye
