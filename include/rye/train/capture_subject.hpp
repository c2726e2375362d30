// SPDX-License-Identifier: Apache-2.0
/// rye/train/capture_subject.hpp: what training takes of a capture's labels: drivers of a frame,
/// landmarks and their roles, the neutral head and its eyeballs. Canonical frame: the head's, of
/// the first training frame. Units as in io/capture.hpp.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <string>

#include <rye/avatar/drivers.hpp>
#include <rye/avatar/weights.hpp>
#include <rye/io/capture.hpp>
#include <rye/io/eye_sizes.hpp>
#include <rye/core/error.hpp>
#include <rye/math/rotation.hpp>
#include <rye/rig/gaze.hpp>

namespace rye {

namespace detail {

/// Number of dense landmarks, about as many as Gaussian Head Avatar keeps (every 100th of 35,709
/// vertices).
inline constexpr int dense_landmarks = 358;

} // namespace detail

/// Properties of the subject from the whole capture.
struct CaptureSubject {
    LandmarkRoles roles;
    Columns<double> neutral;   ///< landmarks of the first training frame, canonical, 3 x L
    Vec3<double> head_centre;  ///< middle of the lattice, canonical
    std::array<Vec3<double>, 2> eye_centre;  ///< neutral, canonical
    std::array<double, 2> eye_radius, limbus_radius, iris_plane;  ///< canonical units
    bool measured_eyes = false;           ///< true if eye centres come from gaze.npz

    /// Returns the neutral eye centres as columns, canonical, 3 x 2.
    Columns<double> eye_centres() const {
        Columns<double> c(3, 2);
        c << eye_centre[0], eye_centre[1];
        return c;
    }
    EyeSizes sizes(std::size_t eye) const {
        return {eye_radius[eye], limbus_radius[eye], iris_plane[eye]};
    }
};

/// The source of eyeballs.
struct EyeSource {
    bool measured = true;          ///< centres and radii from gaze.npz where every frame has them
    double default_radius = 0.12;  ///< of the sclera otherwise, canonical units
};

namespace detail {

inline Vec3<double> eye_landmark_centre(const Columns<double>& landmarks, int eye) {
    Vec3<double> sum = Vec3<double>::Zero();
    for (const int k : eye_landmarks(eye)) sum += landmarks.col(k);
    return sum / 6.0;
}

/// Returns the stride of the vertices that are dense landmarks.
inline Index vertex_stride(const Columns<double>& vertices) {
    return std::max<Index>(1, vertices.cols() / dense_landmarks);
}

} // namespace detail

/// Returns world points in a frame's canonical head frame: R^T (x - T) / S.
inline Columns<double> to_canonical(const CaptureFrame& frame, const Columns<double>& world) {
    const Vec3<double> t = frame.pose.tail<3>();
    return so3_exp(Vec3<double>(frame.pose.head<3>())).transpose() * (world.colwise() - t) /
           frame.scale;
}

/// Returns the sparse landmarks, and from the first every stride-th of the dense vertices.
inline Columns<double> chosen_landmarks(const Columns<double>& landmarks,
                                        const Columns<double>& vertices, Index stride) {
    const Index dense = vertices.cols() == 0 ? 0 : (vertices.cols() - 1) / stride + 1;
    Columns<double> all(3, landmarks.cols() + dense);
    all.leftCols(landmarks.cols()) = landmarks;
    for (Index k = 0; k < dense; ++k) all.col(landmarks.cols() + k) = vertices.col(k * stride);
    return all;
}

/// Returns the sparse landmarks and a selection of the dense vertices, in the order of
/// CaptureSubject::neutral.
inline Columns<double> chosen_landmarks(const Columns<double>& landmarks,
                                        const Columns<double>& vertices) {
    return chosen_landmarks(landmarks, vertices, detail::vertex_stride(vertices));
}

/// Returns landmarks of a frame in the world, in the order of CaptureSubject::neutral.
inline Columns<double> frame_landmarks(const CaptureLabels& capture, int frame) {
    const CaptureFrame& f = capture.frame(frame);
    return chosen_landmarks(f.landmarks, f.vertices);
}

/// Replaces the landmarks of a frame, 3 x L in the world; other vertices are unchanged.
inline void set_frame_landmarks(CaptureFrame& frame, const Columns<double>& landmarks) {
    const Index sparse = frame.landmarks.cols(), stride = detail::vertex_stride(frame.vertices);
    frame.landmarks = landmarks.leftCols(sparse);
    for (Index k = sparse; k < landmarks.cols(); ++k)
        frame.vertices.col((k - sparse) * stride) = landmarks.col(k);
}

/// Returns an eye's gaze along an axis: unit, head frame.
inline Vec3<double> gaze_of(const CaptureEye& eye, GazeAxis axis) {
    return axis == GazeAxis::visual ? eye.visual.value() : eye.optical;
}

/// Throws an Error with the first frame that has no such gazes.
inline void require_gazes(const CaptureLabels& capture, GazeAxis axis) {
    if (axis == GazeAxis::optical) return;
    for (const CaptureFrame& f : capture.frames)
        for (std::size_t e = 0; e < 2; ++e)
            require(f.has_gaze && f.eyes[e].visual, capture.folder.string(), "frame '", f.id,
                    "': gaze.npz has no visual_", (e == 0 ? "left" : "right"),
                    ", expected it in every frame, since the run's gaze_axis is 'visual'");
}

/// Returns the tracked drivers of a frame.
inline Drivers<float> frame_drivers(const CaptureLabels& capture, int frame,
                                    GazeAxis axis = GazeAxis::optical) {
    const CaptureFrame& f = capture.frame(frame);
    Drivers<float> d;
    d.expression = Eigen::Map<const VecX<float>>(f.expression.data(),
                                                 static_cast<Index>(f.expression.size()));
    d.pose = f.pose.cast<float>();
    d.scale = static_cast<float>(f.scale);
    for (std::size_t eye = 0; eye < 2; ++eye)
        d.gaze[eye] = gaze_of(f.eyes[eye], axis).cast<float>();
    return d;
}

namespace detail {

/// Sets sizes and centre of an eyeball, the centre from labels or the landmarks around the eye.
inline void place_eye(CaptureSubject& s, int eye, const CaptureFrame& first,
                      const EyeSizes& sizes) {
    const auto e = static_cast<std::size_t>(eye);
    const CaptureEye& from = first.eyes[e];
    s.eye_radius[e] = sizes.radius;
    s.limbus_radius[e] = sizes.limbus_radius;
    s.iris_plane[e] = sizes.iris_plane;
    if (s.measured_eyes) {
        s.eye_centre[e] = to_canonical(first, *from.centre);
    } else {
        // The lids touch the front of the sphere, so its centre is behind their mean.
        s.eye_centre[e] = eye_landmark_centre(s.neutral, eye);
        s.eye_centre[e].z() -= 0.9 * s.eye_radius[e];
    }
}

} // namespace detail

/// Throws an Error if the capture lacks what training needs (gaze of every frame, training frames).
inline CaptureSubject describe_subject(const CaptureLabels& capture,
                                       const EyeSource& eyes = EyeSource{}) {
    const std::string who = capture.folder.string();
    require(!capture.train.empty(), who, "the capture has no training frames");
    require(capture.has_gaze(), who,
            "a frame has no params/<frame>/gaze.npz; training needs the gaze of every frame");
    const CaptureFrame& first = capture.frame(capture.train.front());
    CaptureSubject s;
    s.neutral = to_canonical(first, frame_landmarks(capture, capture.train.front()));
    const Index sparse = first.landmarks.cols();
    for (Index k = 0; k < s.neutral.cols(); ++k)
        if (k < 36 || k >= 48) s.roles.expression.push_back(k);  // P_0: all except the eyes
    for (int eye = 0; eye < 2; ++eye)
        for (const int k : eye_landmarks(eye))
            s.roles.eye[static_cast<std::size_t>(eye)].push_back(k);

    // Estimated middle of the head: 0.7 face widths behind the tip of the nose and a fifth of one
    // above the middle of the face.
    const Vec3<double> lo = s.neutral.leftCols(sparse).rowwise().minCoeff();
    const Vec3<double> hi = s.neutral.leftCols(sparse).rowwise().maxCoeff();
    const double width = hi.x() - lo.x();
    s.head_centre = Vec3<double>((lo.x() + hi.x()) / 2, (lo.y() + hi.y()) / 2 + 0.2 * width,
                                 hi.z() - 0.7 * width);
    s.measured_eyes = eyes.measured && capture.has_centres();
    for (int eye = 0; eye < 2; ++eye) {
        const CaptureEye& from = first.eyes[static_cast<std::size_t>(eye)];
        const EyeSizes sizes =
            eye_sizes(s.measured_eyes ? from : CaptureEye{}, first.scale, eyes.default_radius);
        require_eyeball(sizes, who + ": frame '" + first.id + "': the " +
                                   (eye == 0 ? "left" : "right") + " eyeball");
        detail::place_eye(s, eye, first, sizes);
    }
    return s;
}

/// Returns the centres of both eyeballs of a frame relative to the neutral ones, canonical, 3 x 2:
/// the target of the eye offset; from gaze.npz, or from the centres of the landmarks around the
/// eyes.
inline Columns<double> eye_displacement(const CaptureLabels& capture,
                                        const CaptureSubject& subject, int frame) {
    const CaptureFrame& f = capture.frame(frame);
    Columns<double> d(3, 2);
    for (int eye = 0; eye < 2; ++eye) {
        if (subject.measured_eyes) {
            const Columns<double> now =
                to_canonical(f, *f.eyes[static_cast<std::size_t>(eye)].centre);
            d.col(eye) = now - subject.eye_centre[static_cast<std::size_t>(eye)];
        } else {
            const Columns<double> now = to_canonical(f, f.landmarks);
            d.col(eye) = detail::eye_landmark_centre(now, eye) -
                         detail::eye_landmark_centre(subject.neutral, eye);
        }
    }
    return d;
}

} // namespace rye
