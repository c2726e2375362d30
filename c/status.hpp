// SPDX-License-Identifier: Apache-2.0
/// c/status.hpp: how the C interfaces turn exceptions into codes, check their arguments and read
/// cameras.
#pragma once

#include <cmath>
#include <exception>
#include <new>
#include <string>

#include <rye/c/rye.h>
#include <rye/core/error.hpp>
#include <rye/core/format.hpp>
#include <rye/geometry/check_camera.hpp>

namespace rye::c {

/// A failure with its code; Error alone is an invalid argument.
struct Failure : Error {
    rye_status status;
    Failure(rye_status s, const std::string& message) : Error(message), status(s) {}
};

/// Keeps a message for last_message(); nothing is thrown for want of memory.
rye_status fail(rye_status status, const char* message) noexcept;

/// Returns the message of the thread's last failure in this library.
const char* last_message() noexcept;

/// f() with every exception as a status.
template <class F>
rye_status guarded(F&& f) noexcept {
    try {
        f();
        return RYE_OK;
    } catch (const Failure& e) {
        return fail(e.status, e.what());
    } catch (const Error& e) {
        return fail(RYE_ERROR_ARGUMENT, e.what());
    } catch (const std::bad_alloc&) {
        return fail(RYE_ERROR_MEMORY, "out of memory");
    } catch (const std::exception& e) {
        return fail(RYE_ERROR_INTERNAL, e.what());
    } catch (...) {
        return fail(RYE_ERROR_INTERNAL, "an unknown exception");
    }
}

/// Error unless the pointer is one.
inline void check_pointer(const void* p, const char* name) {
    require(p != nullptr, name, "got a null pointer");
}

/// Error unless the struct is of the version that this library has.
template <class S>
void check_struct(const S* s, const char* name) {
    check_pointer(s, name);
    if (s->struct_size != sizeof(S))
        throw Failure(RYE_ERROR_VERSION,
                      std::string(name) + ": got struct_size " + std::to_string(s->struct_size) +
                          ", expected " + std::to_string(sizeof(S)) +
                          ": set it by RYE_INIT, with the header of this library");
}

inline void check_finite(const float* values, Index count, const char* name) {
    for (Index i = 0; i < count; ++i)
        if (!std::isfinite(values[i]))
            throw Error(std::string(name) + ": value " + std::to_string(i) + " is " +
                        number_text(values[i]) + ", expected a finite number");
}

/// The camera; Error for one that cannot draw (check_camera).
inline Pinhole<float> camera_of(const rye_camera* c) {
    check_struct(c, "camera");
    Pinhole<float> p;
    p.width = c->width;
    p.height = c->height;
    p.fx = c->fx;
    p.fy = c->fy;
    p.cx = c->cx;
    p.cy = c->cy;
    p.near_depth = c->near_depth;
    const float* m = c->camera_from_world;
    for (Index row = 0; row < 3; ++row) {
        for (Index col = 0; col < 3; ++col)
            p.camera_from_world.rotation(row, col) = m[4 * row + col];
        p.camera_from_world.translation[row] = m[4 * row + 3];
    }
    require(m[12] == 0 && m[13] == 0 && m[14] == 0 && m[15] == 1, "camera: camera_from_world",
            "the last row is no 0 0 0 1");
    check_camera("rye_camera", p);
    return p;
}

inline void set_camera(const Pinhole<float>& p, rye_camera& c) {
    c.width = p.width;
    c.height = p.height;
    c.fx = p.fx;
    c.fy = p.fy;
    c.cx = p.cx;
    c.cy = p.cy;
    c.near_depth = p.near_depth;
    float* m = c.camera_from_world;
    for (Index row = 0; row < 3; ++row) {
        for (Index col = 0; col < 3; ++col)
            m[4 * row + col] = p.camera_from_world.rotation(row, col);
        m[4 * row + 3] = p.camera_from_world.translation[row];
    }
    m[12] = m[13] = m[14] = 0;
    m[15] = 1;
}

} // namespace rye::c
