// SPDX-License-Identifier: Apache-2.0
#include "drawing/dispatch.hpp"

#include <doctest/doctest.h>

using namespace rye;
using namespace rye::trainer;
using enum EffectName;

namespace {

template <EffectName... E>
struct Some {
    static constexpr EffectMask effects{E...};
};
struct NoEffects {};
struct Late {
    static inline EffectMask effects;  // set at run time
};
static_assert(Variant<Some<sh1>> && Variant<Some<>> && !Variant<NoEffects> && !Variant<Late>);

using List = Variants<Some<expression, head_pose, left_gaze, right_gaze>, Some<left_gaze, right_gaze>,
                      Some<left_gaze, head_pose>, Some<>>;

std::string run(const EffectMask& called) {
    return dispatch(List{}, called, []<class V>(V) { return text_of(V::effects); });
}

} // namespace

TEST_CASE("dispatch: the smallest variant that contains the effects") {
    CHECK(run({}) == "none");
    CHECK(run({left_gaze}) == "left gaze, right gaze");  // the first of two of the same size
    CHECK(run({right_gaze}) == "left gaze, right gaze");
    CHECK(run({head_pose}) == "head pose, left gaze");
    CHECK(run({head_pose, right_gaze}) == "expression, head pose, left gaze, right gaze");
    static_assert(List::smallest({expression}) == 0);
    static_assert(List::smallest({kappa}) == List::count);
}

TEST_CASE("dispatch: a scene that nothing was compiled for is an error that says what is missing") {
    CHECK_THROWS_WITH_AS(
        run({left_gaze, kappa}),
        "dispatch: got a scene that calls for left gaze, kappa, expected one of 4 compiled variants "
        "to have all of it; the nearest lacks kappa",
        Error);
}

TEST_CASE("dispatch: what the variant returns, also a reference") {
    int x = 3;
    int& y = dispatch(Variants<Some<>>{}, {}, [&](auto) -> int& { return x; });
    CHECK(&x == &y);
}

TEST_CASE("effects_of: names as the documents write them, and what is none is named") {
    CHECK(effects_of("head pose, left gaze", "who") == EffectMask{head_pose, left_gaze});
    CHECK(effects_of("super-resolution,left_gaze", "who") == EffectMask{super_resolution, left_gaze});
    CHECK(effects_of("super resolution", "who") == EffectMask{super_resolution});
    CHECK(effects_of("none", "who") == EffectMask{});
    for (std::size_t k = 0; k < effect_count; ++k)
        CHECK(effects_of(effect_names[k], "who") == EffectMask{static_cast<EffectName>(k)});
    for (const char* bad : {"", ",", "left", "left gaze,", "left gaze smile"})
        CHECK_THROWS_AS(effects_of(bad, "who"), Error);
    CHECK_THROWS_WITH_AS(effects_of("left gaze, smile", "--effects"),
                         doctest::Contains("--effects: got 'smile', expected names of effects: "
                                           "expression, head pose, "),
                         Error);
}
