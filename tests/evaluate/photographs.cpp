// SPDX-License-Identifier: Apache-2.0
// gaze_of_photographs CAPTURE [RUN]: the gaze estimator on all photographs of a capture, against
// its labels, as tables in Markdown: given the capture's eyeballs and eye masks, given areas that
// lie too high, and, with a run, given what the run's own eyeballs show. docs/results/evaluation.md has
// some.
#include "photographs.hpp"

#include <array>
#include <cstdio>
#include <exception>

#include "data/validate.hpp"
#include "model/run.hpp"

using namespace rye;
using namespace rye::test;
using namespace rye::trainer;

namespace {

void print_row(const std::string& name, const std::vector<PhotographedEye>& eyes) {
    const GazeSummary s = summary(eyes);
    if (s.eyes == 0) return;
    std::printf("| %s | %d | %d | %.1f° | %.1f° | %.1f° | %.1f° |\n", name.c_str(), s.eyes,
                s.eyes - s.missed, s.mean, s.median, s.tenth, s.visual);
}

template <class Keep>
void print_part(const std::string& name, const std::vector<PhotographedEye>& eyes, Keep keep) {
    std::vector<PhotographedEye> part;
    for (const PhotographedEye& e : eyes)
        if (keep(e)) part.push_back(e);
    print_row(name, part);
}

void print_split(const std::string& name, const Capture& capture, const std::vector<int>& frames,
                 const EyesOf& eyes_of) {
    for (const double scale : {1.0, 0.5, 1.5}) {
        const std::vector<PhotographedEye> eyes =
            gaze_of_photographs(capture, frames, scale, eyes_of);
        char size[48];
        std::snprintf(size, sizeof size, ", %d px", static_cast<int>(capture.width * scale));
        print_row(name + size, eyes);
        if (scale != 1) continue;
        for (std::size_t e = 0; e < 2; ++e)
            print_part(e == 0 ? "... left eye" : "... right eye", eyes,
                       [e](const PhotographedEye& p) { return p.eye == e; });
        constexpr std::array<double, 6> yaw{-90, -45, -15, 15, 45, 90};
        for (std::size_t k = 0; k + 1 < yaw.size(); ++k) {
            char part[64];
            std::snprintf(part, sizeof part, "... camera %.0f° to %.0f° outward", yaw[k],
                          yaw[k + 1]);
            print_part(part, eyes, [&](const PhotographedEye& p) {
                return p.outward >= yaw[k] && p.outward < yaw[k + 1];
            });
        }
    }
}

void print_table(const std::string& title, const Capture& capture, const EyesOf& eyes_of) {
    std::printf(
        "\n%s\n\n| photographs | visible eyes | irises found | mean error | median "
        "| 90th percentile | mean, visual axis |\n|---|---|---|---|---|---|---|\n",
        title.c_str());
    std::fflush(stdout);
    print_split("training", capture, capture.train, eyes_of);
    print_split("test", capture, capture.test, eyes_of);
}

} // namespace

int main(int count, char** arguments) {
    if (count != 2 && count != 3) {
        std::fprintf(stderr, "usage: gaze_of_photographs CAPTURE [RUN]\n");
        return 2;
    }
    try {
        const Capture capture = read_valid_capture(arguments[1]);
        if (!capture.has_centres() || !capture.has_eye_masks) {
            std::fprintf(stderr, "%s: expected measured eyeballs and eye masks of every frame\n",
                         arguments[1]);
            return 2;
        }
        print_table("Given the capture's eyeballs and eye masks:", capture,
                    [&](int f, int c) { return labelled_eyes(capture, f, c); });
        print_table("Given the capture's eyeballs and areas that lie 0.15 radii too high:", capture,
                    [&](int f, int c) { return raised_eyes(capture, f, c, 0.15); });
        if (count == 2) {
            std::printf("\nnot run: what a run's own eyeballs give, for no run is named\n");
            return 0;
        }
        const TrainState run = load_trained(arguments[2]);
        const Evaluation evaluation(run, capture);
        print_table("Given what the run's own eyeballs show (without labels):", capture,
                    [&](int f, int c) {
                        return evaluation.own_eyes(frame_drivers(capture, f, run.config.gaze_axis),
                                                   capture.camera(f, c));
                    });
        return 0;
    } catch (const std::exception& e) {
        std::fprintf(stderr, "%s\n", e.what());
        return 2;
    }
}
