/* SPDX-License-Identifier: Apache-2.0 */
/* page.c: what worker.js calls, flat functions over the interface for C: one avatar, its drivers,
 * its camera and its picture, which stay in this module's memory. A function that fails returns a
 * status other than 0; page_message() then says why. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <emscripten/emscripten.h>

#include <rye/c/rye.h>

enum { most_expressions = 1024 };

static rye_avatar* avatar;
static rye_drivers drivers;
static rye_camera camera;
static rye_avatar_info info;
static rye_picture picture;
static rye_cloud cloud;
static rye_upsampler network;
static float expression[most_expressions], living[most_expressions];
static float* background; /* a number for each channel */

EMSCRIPTEN_KEEPALIVE const char* page_message(void) { return rye_message(); }

/* Opens the bytes of an avatar file, to be drawn by so many threads; a picture is then page_size's to
 * size. */
EMSCRIPTEN_KEEPALIVE int page_open(const char* name, const void* bytes, int size, int threads) {
    rye_options options = RYE_INIT(rye_options);
    const rye_drivers no_drivers = RYE_INIT(rye_drivers);
    const rye_camera no_camera = RYE_INIT(rye_camera);
    const rye_avatar_info no_info = RYE_INIT(rye_avatar_info);
    const rye_picture no_picture = RYE_INIT(rye_picture);
    const rye_upsampler no_network = RYE_INIT(rye_upsampler);
    rye_avatar_close(avatar);
    avatar = NULL;
    free(picture.rgba);
    free(background);
    background = NULL;
    drivers = no_drivers, camera = no_camera, info = no_info, picture = no_picture;
    network = no_network;
    options.threads = threads;
    rye_status status = rye_avatar_open_memory(name, bytes, (size_t)size, &options, &avatar);
    if (status == RYE_OK) status = rye_avatar_describe(avatar, &info);
    if (status == RYE_OK) status = rye_avatar_neutral(avatar, &drivers, &camera);
    if (status == RYE_OK) status = rye_avatar_upsampler(avatar, &network);
    if (status != RYE_OK) return status;
    if (info.expression_count > most_expressions) return -1;
    background = malloc(sizeof(float) * (size_t)info.channels);
    if (background == NULL) return RYE_ERROR_MEMORY;
    memcpy(background, info.background, sizeof(float) * (size_t)info.channels);
    if (info.expression_count > 0)
        memcpy(expression, drivers.expression, sizeof(float) * (size_t)info.expression_count);
    drivers.expression = expression;
    return RYE_OK;
}

EMSCRIPTEN_KEEPALIVE const char* page_name(void) { return info.name; }
EMSCRIPTEN_KEEPALIVE int page_expressions(void) { return info.expression_count; }
EMSCRIPTEN_KEEPALIVE int page_gaussians(void) { return (int)info.gaussians; }
EMSCRIPTEN_KEEPALIVE const char* page_expression_name(int i) {
    return info.expression_names == NULL ? "" : info.expression_names[i];
}
EMSCRIPTEN_KEEPALIVE float* page_expression(void) { return expression; }
EMSCRIPTEN_KEEPALIVE const float* page_expression_low(void) { return info.expression_low; }
EMSCRIPTEN_KEEPALIVE const float* page_expression_high(void) { return info.expression_high; }
EMSCRIPTEN_KEEPALIVE float* page_gaze(void) { return drivers.gaze[0]; }           /* 4 */
EMSCRIPTEN_KEEPALIVE const float* page_gaze_low(void) { return info.gaze_low[0]; }   /* 4 */
EMSCRIPTEN_KEEPALIVE const float* page_gaze_high(void) { return info.gaze_high[0]; } /* 4 */
EMSCRIPTEN_KEEPALIVE float* page_pose(void) { return drivers.pose; }              /* 6 */
EMSCRIPTEN_KEEPALIVE float page_scale(void) { return drivers.scale; }
EMSCRIPTEN_KEEPALIVE const float* page_eyes(void) { return info.eye[0]; }         /* 6 */
EMSCRIPTEN_KEEPALIVE const float* page_head(void) { return info.head; }           /* 3 */
EMSCRIPTEN_KEEPALIVE float page_radius(void) { return info.radius; }
/* camera_from_world, 16, then fx, fy, cx, cy. */
EMSCRIPTEN_KEEPALIVE float* page_motion(void) { return camera.camera_from_world; }
EMSCRIPTEN_KEEPALIVE float* page_lens(void) { return &camera.fx; }
EMSCRIPTEN_KEEPALIVE int page_width(void) { return camera.width; }
EMSCRIPTEN_KEEPALIVE int page_height(void) { return camera.height; }

/* The picture's size in pixels; the field of view stays. */
EMSCRIPTEN_KEEPALIVE int page_size(int width, int height) {
    if (picture.rgba != NULL && width == camera.width && height == camera.height) return RYE_OK;
    const float x = (float)width / (float)camera.width, y = (float)height / (float)camera.height;
    camera.fx *= x, camera.cx *= x, camera.fy *= y, camera.cy *= y;
    camera.width = width, camera.height = height;
    free(picture.rgba);
    picture.rgba = malloc((size_t)4 * (size_t)width * (size_t)height);
    return picture.rgba == NULL ? RYE_ERROR_MEMORY : RYE_OK;
}

/* Turns both eyes to a point of the world. */
EMSCRIPTEN_KEEPALIVE int page_look(float x, float y, float z) {
    const float point[3] = {x, y, z};
    return rye_avatar_gaze_at(avatar, &drivers, point, 0.8f, NULL);
}

/* Pitch and yaw of both eyes that look at a point of the world, 4; null on failure. Moves nothing. */
EMSCRIPTEN_KEEPALIVE const float* page_aim(float x, float y, float z) {
    static rye_drivers aimed;
    const float point[3] = {x, y, z};
    aimed = drivers;
    return rye_avatar_gaze_at(avatar, &aimed, point, 1.22f, NULL) == RYE_OK ? aimed.gaze[0] : NULL;
}

static rye_status alive(rye_drivers* moved, double seconds, float range) {
    *moved = drivers;
    return seconds < 0 ? RYE_OK : rye_avatar_idle(avatar, moved, living, 1, seconds, range);
}

static double moves;
/* Counts the Gaussians that the last picture or drive moved; an error may have moved any. */
static rye_status count_moves(rye_status status) {
    rye_avatar_work work = RYE_INIT(rye_avatar_work);
    if (status == RYE_OK && rye_avatar_last_work(avatar, &work) == RYE_OK)
        moves += (double)work.gaussians;
    else
        moves += 1;
    return status;
}

/* Draws; with `seconds` from 0 on, the eyes have lived by themselves for so long, within `range`. */
EMSCRIPTEN_KEEPALIVE int page_draw(double seconds, float range) {
    rye_drivers moved;
    rye_status status = alive(&moved, seconds, range);
    if (status == RYE_OK) status = rye_avatar_draw(avatar, &moved, &camera, background, &picture);
    return count_moves(status);
}
EMSCRIPTEN_KEEPALIVE const unsigned char* page_pixels(void) { return picture.rgba; }

/* The feature behind the head, which page_draw and WebGPU draw over. */
EMSCRIPTEN_KEEPALIVE float* page_background(void) { return background; }

/* For WebGPU: moves the Gaussians as page_draw does, and draws nothing. Their arrays, the camera of
 * their render, and the network after it are these. */
EMSCRIPTEN_KEEPALIVE int page_drive(double seconds, float range) {
    const rye_cloud no_cloud = RYE_INIT(rye_cloud);
    rye_drivers moved;
    rye_status status = alive(&moved, seconds, range);
    cloud = no_cloud;
    if (status == RYE_OK) status = rye_avatar_drive(avatar, &moved, &camera);
    if (status == RYE_OK) status = rye_avatar_gaussians(avatar, &cloud);
    return count_moves(status);
}
/* As long as this number stays, no Gaussian has moved or changed its colour. */
EMSCRIPTEN_KEEPALIVE double page_moves(void) { return moves; }
EMSCRIPTEN_KEEPALIVE const rye_cloud* page_cloud(void) { return &cloud; }
EMSCRIPTEN_KEEPALIVE const float* page_mean(void) { return cloud.mean; }
EMSCRIPTEN_KEEPALIVE const float* page_rotation(void) { return cloud.rotation; }
EMSCRIPTEN_KEEPALIVE const float* page_gaussian_scale(void) { return cloud.scale; }
EMSCRIPTEN_KEEPALIVE const float* page_opacity(void) { return cloud.opacity; }
EMSCRIPTEN_KEEPALIVE const float* page_feature(void) { return cloud.feature; }
/* render_camera of rye/avatar/playable.hpp. */
EMSCRIPTEN_KEEPALIVE const rye_camera* page_render_camera(void) {
    static rye_camera render;
    const int factor = 1 << network.doublings;
    const float share = 1.0f / (float)factor;
    render = camera;
    render.fx *= share, render.cx *= share, render.fy *= share, render.cy *= share;
    render.width = (camera.width + factor - 1) / factor;
    render.height = (camera.height + factor - 1) / factor;
    return &render;
}
/* fx, fy, cx, cy, near depth, width, height */
EMSCRIPTEN_KEEPALIVE const float* page_render_lens(void) {
    static float numbers[7];
    const rye_camera* render = page_render_camera();
    memcpy(numbers, &render->fx, 5 * sizeof(float));
    numbers[5] = (float)render->width, numbers[6] = (float)render->height;
    return numbers;
}
/* The dilation of the driven Gaussians [px^2]; below 0 before there are any. */
EMSCRIPTEN_KEEPALIVE float page_dilation(void) {
    float dilation = -1;
    rye_avatar_dilation(avatar, &dilation);
    return dilation;
}
/* channels, capacity, doublings, normalized, skip */
EMSCRIPTEN_KEEPALIVE const int* page_network(void) { return &network.channels; }
EMSCRIPTEN_KEEPALIVE const float* page_convolution(int layer) { return network.convolution[layer]; }
EMSCRIPTEN_KEEPALIVE const float* page_out_weight(void) { return network.out_weight; }
EMSCRIPTEN_KEEPALIVE const float* page_out_bias(void) { return network.out_bias; }

/* Of the last picture: Gaussians that moved, tiles blended, pixels computed. */
EMSCRIPTEN_KEEPALIVE const int* page_work(void) {
    static int numbers[3];
    rye_avatar_work work = RYE_INIT(rye_avatar_work);
    if (rye_avatar_last_work(avatar, &work) != RYE_OK) return NULL;
    numbers[0] = (int)work.gaussians, numbers[1] = (int)work.tiles, numbers[2] = (int)work.pixels;
    return numbers;
}
