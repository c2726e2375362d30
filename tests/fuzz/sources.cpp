// SPDX-License-Identifier: Apache-2.0
/// tests/fuzz/sources.cpp: any bytes as a file of `rye import`. The first byte chooses the kind:
/// cameras or pictures of COLMAP, binary or text; a mesh; a table of gazes; a calibration; LZF data,
/// of which two further bytes state the size.
#include "fuzz.hpp"

#include "importers/colmap_model.hpp"
#include "importers/flame.hpp"
#include "importers/gaze_file.hpp"
#include "importers/hdf5_file.hpp"
#include "importers/opencv_xml.hpp"

namespace {

using namespace rye;
using namespace rye::trainer;

void check(const ColmapCameras& cameras) {
    for (const auto& [id, p] : cameras)
        fuzz::demand(p.camera.width > 0 && p.camera.height > 0 && p.camera.fx > 0 &&
                         p.camera.fy > 0 && std::isfinite(p.camera.cx + p.camera.cy),
                     "cameras are finite");
}
void check(const std::vector<ColmapPicture>& pictures) {
    for (const ColmapPicture& p : pictures)
        fuzz::demand(p.camera_from_world.rotation.allFinite() &&
                         p.camera_from_world.translation.allFinite() && !p.name.empty(),
                     "poses are finite");
}
void check(const TriangleMesh<double>& mesh) {
    fuzz::demand(mesh.vertices.allFinite(), "vertices are finite");
    for (const auto& face : mesh.faces)
        for (const auto corner : face)
            fuzz::demand(corner >= 0 && static_cast<Index>(corner) < mesh.vertices.cols(),
                         "faces have vertices of the mesh");
}

void read(unsigned kind, ByteSpan bytes) {
    switch (kind % 8) {
    case 0: return check(parse_colmap_cameras(bytes, ColmapFormat::binary, fuzz::name));
    case 1: return check(parse_colmap_cameras(bytes, ColmapFormat::text, fuzz::name));
    case 2: return check(parse_colmap_pictures(bytes, ColmapFormat::binary, fuzz::name));
    case 3: return check(parse_colmap_pictures(bytes, ColmapFormat::text, fuzz::name));
    case 4: return check(parse_obj(as_text(bytes), fuzz::name));
    case 5:
        for (const auto& [frame, gaze] : parse_gaze_csv(as_text(bytes), fuzz::name))
            fuzz::demand(std::abs(gaze[0].norm() - 1) < 1e-6 && gaze[1].allFinite(), "unit gazes");
        return;
    case 6: {
        const Rigid<double> pose = OpencvXml(std::string(as_text(bytes)), fuzz::name).pose();
        fuzz::demand(pose.rotation.allFinite() && pose.translation.allFinite(), "a finite pose");
        return;
    }
    default: {
        if (bytes.size() < 2) return;
        const std::size_t size =
            std::to_integer<std::size_t>(bytes[0]) + 256 * std::to_integer<std::size_t>(bytes[1]);
        const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data()) + 2;
        fuzz::demand(decode_lzf(data, bytes.size() - 2, size, fuzz::name).size() == size,
                     "the stated size");
    }
    }
}

} // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    fuzz::attempt([&] { read(data[0], {reinterpret_cast<const std::byte*>(data) + 1, size - 1}); });
    return 0;
}
