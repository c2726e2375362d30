// SPDX-License-Identifier: Apache-2.0
/// make_import_source KIND FOLDER [FRAMES CAMERAS SIZE]: writes a synthetic capture to FOLDER/truth
/// and a source of that kind, made from it, to FOLDER/source.
/// make_import_source compare TRUTH CAPTURE: prints the largest differences of an import.
#include <cstdlib>
#include <iostream>
#include <string>

#include <rye/core/error.hpp>

#include "comparison.hpp"
#include "sources.hpp"

int main(int argc, char** argv) {
    using namespace rye::trainer;
    try {
        if (argc == 4 && std::string(argv[1]) == "compare") {
            std::cout << compare(read_capture(argv[2]), read_capture(argv[3])).text() << "\n";
            return 0;
        }
        rye::require(argc == 3 || argc == 6, "make_import_source",
                     "expected KIND FOLDER [FRAMES CAMERAS SIZE]");
        const std::string kind = argv[1];
        const std::filesystem::path folder = argv[2];
        CaptureSettings s;
        s.train_frames = argc == 6 ? std::atoi(argv[3]) : 12;
        s.cameras = argc == 6 ? std::atoi(argv[4]) : 6;
        s.size = argc == 6 ? std::atoi(argv[5]) : 128;
        s.novel_frames = 2;
        s.independent_frames = 1;
        const TrueScene truth = true_scene(folder / "truth", s);
        const std::filesystem::path source = folder / "source";
        if (kind == "vhap")
            write_vhap_source(truth, source);
        else if (kind == "gha")
            write_gha_source(truth, source, 0.1);
        else if (kind == "blender")
            write_blender_source(truth, source);
        else if (kind == "transforms")
            write_transforms_source(truth, source, true);
        else if (kind == "colmap")
            write_colmap_source(truth, source, ColmapFiles::binary, true);
        else if (kind == "xgaze")
            write_xgaze_source(truth, source, folder / "calibration", XgazeFields::normalization);
        else if (kind == "gazenerf")
            write_xgaze_source(truth, source, {}, XgazeFields::gazenerf);
        else
            throw rye::Error("make_import_source: got the kind '" + kind + "'");
        std::cout << source.string() << "\n";
    } catch (const std::exception& e) {
        std::cerr << e.what() << "\n";
        return 1;
    }
    return 0;
}
