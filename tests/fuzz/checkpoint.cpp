// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/checkpoint.cpp: any bytes as the checkpoint that a training goes on from.
#include "fuzz.hpp"

#include "model/run.hpp"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace rye;
    fuzz::attempt([&] {
        const trainer::TrainState s =
            trainer::parse_checkpoint(fuzz::unchecked(data, size), fuzz::name);
        fuzz::demand(s.step >= 0 && !s.train_frames.empty(), "there is something to train");
        fuzz::demand(s.subject.neutral.allFinite() && s.avatar.face.position.allFinite(),
                     "its numbers are finite");
        fuzz::demand(s.avatar.face.position.size() * Index(sizeof(float)) <=
                         static_cast<Index>(size),
                     "an avatar is no larger than its file");
        if (s.stage == trainer::Stage::avatar) trainer::drawn_state(s);
    });
    return 0;
}
