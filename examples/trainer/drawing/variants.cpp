// SPDX-License-Identifier: Apache-2.0
#include "drawing/variants.hpp"

#include <optional>

#include "drawing/shown.hpp"
#include "drawing/variant_list.hpp"

namespace rye::trainer {
namespace {

/// Returns the effects of a variant by its name, or of a list of names.
EffectMask parsed(const std::string& wanted, const std::string& option) {
    return []<class... V>(Variants<V...>, const std::string& text, const std::string& who) {
        const EffectMask* found = nullptr;
        ((text == V::name ? void(found = &V::effects) : void()), ...);
        std::string names;
        ((names += (names.empty() ? "" : ", ") + std::string(V::name)), ...);
        return found != nullptr ? *found
                                : effects_of(text, who + " (one of the variants " + names +
                                                       ", or names of effects)");
    }(AvatarVariants(), wanted, option);
}

/// Returns the effects for which the state's avatar has parameters, and Pupil if a frame uses it.
EffectMask trained_effects(const TrainState& state, const std::vector<DrawnFrame>& frames) {
    EffectMask m = effect_mask<PaperEffects>;
    for (const DrawnFrame& f : frames)
        if (f.pupil != PupilRatios{1, 1}) m.add(EffectName::pupil);
    if (state.avatar.eyes.kappa.size() > 0) m.add(EffectName::kappa);
    if (state.avatar.eyes.optics.refracts()) m.add(EffectName::corneal_refraction);
    if (state.avatar.eyes.optics.lights() > 0) m.add(EffectName::glint);
    if (state.avatar.eyes.has_lid_shadow()) m.add(EffectName::lid_shadow);
    if (state.avatar.shading.any()) m.add(EffectName::head_shading);
    if (state.avatar.has_view_color()) m.add(EffectName::view_color);
    if (has_driven_eyes(state.avatar)) m.add(EffectName::eye_appearance);
    return m;
}

/// Returns a frame's drivers with its camera.
SeenDrivers seen(const DrawnFrame& frame) { return all_drivers(frame, frame.camera); }

} // namespace

std::string left_out_on_device(const std::string& wanted, const std::string& option) {
    if (wanted.empty() || wanted == "auto" ||
        parsed(wanted, option).contains(effect_mask<PaperEffects>))
        return "";
    return option + " " + wanted + " leaves effects out, and a device draws all that was trained";
}

FrameDrawer::FrameDrawer(AvatarDrawer on_device)
    : state_(&on_device.state()),
      on_device_(std::move(on_device)),
      variant_(PaperVariant::name),
      explanation_("variant        " + variant_ + ": all that is trained, as a device draws\n") {}

FrameDrawer::FrameDrawer(const TrainState& state, const std::vector<DrawnFrame>& frames,
                         const std::string& wanted, const std::string& option, double bound)
    : state_(&state) {
    require(!frames.empty(), "FrameDrawer", "got no frames, expected at least one");
    if (state.compared) {
        const bool all = wanted.empty() || wanted == "auto" ||
                         parsed(wanted, option).contains(effect_mask<PaperEffects>);
        require(all, option,
                "got '" + wanted + "', expected auto or " + std::string(PaperVariant::name) +
                    ": effects are left out only of a run whose avatar.gaze_mechanism is "
                    "'rotation'");
        variant_ = PaperVariant::name;
        driver_ = [&state](const SeenDrivers& d) { return driven_gaussians(state, d); };
        explanation_ = "variant        " + variant_ +
                       ": all that is trained, as of every run with another gaze mechanism than "
                       "rotation\n";
        return;
    }
    std::vector<DrawnFrame> optical = frames;
    std::vector<Drivers<float>> drivers;
    for (DrawnFrame& f : optical) {
        f.drivers = optical_drivers(state, f.drivers).drivers;
        drivers.push_back(f.drivers);
    }
    // Counted only if it decides, or if there is a loss to explain.
    std::optional<SceneProfile> counted;
    const auto judged = [&]() -> const SceneProfile& {
        if (counted) return *counted;
        SceneFacts facts;
        facts.drivers = driver_facts(state, optical);
        facts.avatar = avatar_facts(state, drivers, true);
        ProfileBounds bounds;
        bounds.color = bound;
        return counted.emplace(profile(facts, bounds));
    };
    const EffectMask trained = trained_effects(state, frames);
    const auto called = [&] {
        const EffectMask all = judged().effects;
        return all.without(all.without(trained));
    };
    const std::string pictures = std::to_string(frames.size()) + " pictures";
    const bool free = wanted.empty() || wanted == "auto", single = free && frames.size() == 1;
    const EffectMask taken = single ? trained : free ? called() : parsed(wanted, option);

    dispatch(AvatarVariants(), taken, [&]<class V>(V) {
        variant_ = V::name;
        driver_ = driver_of<typename V::List>(state.avatar, state.config.avatar,
                                              state.subject.roles, seen(frames.front()));
        const EffectMask drawn = trained.without(trained.without(V::effects));
        explanation_ = "variant        " + variant_ + " (" + text_of(drawn) + "): ";
        if (single)
            explanation_ += "one picture, and leaving effects out takes a frame with all of them\n";
        else
            explanation_ +=
                "of " + std::to_string(AvatarVariants::count) +
                " that are compiled the smallest with what " +
                (free ? pictures + " call for: " + text_of(called()) : option + " asks for") + "\n";
        if (V::effects.contains(trained)) return; // nothing is left out
        for (const Finding& f : judged().findings) {
            if (!trained.has(f.effect) || V::effects.has(f.effect)) continue;
            explanation_ += std::string(f.called ? "  NOT drawn    " : "  left out     ") +
                            std::string(name_of(f.effect)) + ": " + f.reason +
                            (f.called ? "; held as in the first of " + pictures : "") + "\n";
        }
    });
}

Image<float> FrameDrawer::picture(const DrawnFrame& frame) const {
    if (on_device_) return on_device_->picture(frame);
    return picture_of(*state_, driver_(seen(frame)), frame.camera, frame.dilation);
}

Image<float> FrameDrawer::picture_by_all(const DrawnFrame& frame) const {
    return picture_of(*state_, driven_gaussians(*state_, seen(frame)), frame.camera,
                      frame.dilation);
}

} // namespace rye::trainer
