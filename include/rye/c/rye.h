/* SPDX-License-Identifier: Apache-2.0 */
/* rye/c/rye.h: rye for programs in C and for languages that call C: images and gradients of a cloud
 * of 3D Gaussians, and avatar files drawn by drivers. C99 or later; the library is rye_c.
 *
 * Conventions. Cameras are OpenCV's: x right, y down, z forward; a pixel (x, y) covers [x, x+1) x
 * [y, y+1). Images are row by row, top row first, the channels of a pixel adjacent. Quaternions are
 * (w, x, y, z). The head frame has x to the subject's left, y up and z out of the face; eye 0 is
 * the subject's left. Angles are radians.
 *
 * Errors. Every function that can fail returns a rye_status; rye_message() then has a sentence with
 * the argument or the file, the value found and its bound. On failure no output is written. No C++
 * exception leaves the library.
 *
 * Versions. A struct begins with struct_size, which RYE_INIT(type) sets; a library that knows
 * another size of it returns RYE_ERROR_VERSION.
 *
 * Threads. An object belongs to one thread at a time; different objects are independent. */
#ifndef RYE_C_RYE_H
#define RYE_C_RYE_H

#include <stddef.h>
#include <stdint.h>

#if defined(RYE_C_STATIC)
#define RYE_API
#elif defined(_WIN32) && defined(RYE_C_BUILDING)
#define RYE_API __declspec(dllexport)
#elif defined(_WIN32)
#define RYE_API __declspec(dllimport)
#elif defined(__GNUC__)
#define RYE_API __attribute__((visibility("default")))
#else
#define RYE_API
#endif

/* A zeroed struct of this type that knows its size:  rye_camera camera = RYE_INIT(rye_camera); */
#ifdef __cplusplus
template <class Struct>
Struct rye_initialized() {
    Struct s{};
    s.struct_size = static_cast<uint32_t>(sizeof(Struct));
    return s;
}
#define RYE_INIT(type) rye_initialized<type>()
extern "C" {
#else
#define RYE_INIT(type) { .struct_size = (uint32_t)sizeof(type) }
#endif

/* The version of this interface: functions and structs are only added while it stays. */
#define RYE_C_VERSION 1

typedef enum rye_status {
    RYE_OK = 0,
    RYE_ERROR_ARGUMENT = 1, /* an argument, or a number in it, is invalid */
    RYE_ERROR_FILE = 2,     /* a file cannot be read, is of another kind, or is damaged */
    RYE_ERROR_VERSION = 3,  /* a struct_size that this library does not know */
    RYE_ERROR_STATE = 4,    /* a call that must come before has not been made */
    RYE_ERROR_MEMORY = 5,   /* out of memory */
    RYE_ERROR_INTERNAL = 6  /* a fault of the library */
} rye_status;

/* RYE_C_VERSION of the library. */
RYE_API uint32_t rye_c_version(void);

/* The message of the last call of this thread that failed; never null, valid until the next. */
RYE_API const char* rye_message(void);

/* ---- cameras -------------------------------------------------------------------------------- */

/* A pinhole: u = fx x / z + cx, v = fy y / z + cy [px]. */
typedef struct rye_camera {
    uint32_t struct_size;
    int32_t width, height;       /* [px], 1 to 16384 */
    float fx, fy;                /* focal lengths [px], positive */
    float cx, cy;                /* principal point [px]; the centre of an image is (w/2, h/2) */
    float near_depth;            /* closest visible depth [world units], positive */
    float camera_from_world[16]; /* rows of a 4 x 4 rigid motion; the last one is 0 0 0 1 */
} rye_camera;

/* The point from where, the point in the image centre, and a direction that is up in the image. */
typedef struct rye_look {
    uint32_t struct_size;
    float eye[3], target[3], up[3]; /* [world units] */
    float vertical_fov;             /* between 0 and pi */
    int32_t width, height;          /* [px] */
} rye_look;

/* Sets *camera, whose struct_size must be set; near_depth becomes 0.01. */
RYE_API rye_status rye_camera_look_at(const rye_look* look, rye_camera* camera);

/* ---- a cloud: image and gradient ------------------------------------------------------------ */

typedef enum rye_accuracy {
    RYE_ACCURACY_BALANCED = 0, /* errors below 1/255; docs/accuracy.md has figures */
    RYE_ACCURACY_FAST = 1,
    RYE_ACCURACY_TIGHT = 2,
    RYE_ACCURACY_3DGS = 3 /* as viewers of 3D Gaussian splatting draw */
} rye_accuracy;

/* Settings of a renderer or an avatar. */
typedef struct rye_options {
    uint32_t struct_size;
    int32_t threads;  /* 0: one for each processor */
    int32_t accuracy; /* a rye_accuracy; avatars are always drawn as they were trained */
} rye_options;

/* N Gaussians with C channels; arrays of the caller, read without a copy. */
typedef struct rye_cloud {
    uint32_t struct_size;
    int32_t channels;      /* C, 1 to 1024 */
    int64_t count;         /* N */
    const float* mean;     /* 3 N [world units] */
    const float* rotation; /* 4 N, of any norm but 0 */
    const float* scale;    /* 3 N, standard deviations along the own axes [world units] */
    const float* opacity;  /* N, in 0..1 */
    const float* feature;  /* C N */
} rye_cloud;

/* Where to write images; null for those not wanted. Sizes are the camera's W x H. */
typedef struct rye_image {
    uint32_t struct_size;
    float* feature;  /* C W H */
    float* alpha;    /* W H, in 0..1 */
    float* depth;    /* W H, sum of weights times depth [world units] */
    int64_t skipped; /* out: Gaussians not drawn for a number that is not finite */
} rye_image;

/* Gradients of a loss with respect to the images; null where it does not depend on one. */
typedef struct rye_image_gradient {
    uint32_t struct_size;
    const float *feature, *alpha, *depth;
} rye_image_gradient;

/* Where to write those with respect to the cloud; null for those not wanted. Sizes are the cloud's. */
typedef struct rye_cloud_gradient {
    uint32_t struct_size;
    float *mean, *rotation, *scale, *opacity, *feature;
} rye_cloud_gradient;

/* Threads, memory that is used again, and the last image for its gradient. */
typedef struct rye_renderer rye_renderer;

/* options may be null. */
RYE_API rye_status rye_renderer_create(const rye_options* options, rye_renderer** renderer);
RYE_API void rye_renderer_destroy(rye_renderer* renderer); /* null does nothing */

/* Draws over `background`, C numbers. */
RYE_API rye_status rye_draw(rye_renderer* renderer, const rye_cloud* cloud,
                            const rye_camera* camera, const float* background, rye_image* image);

/* The gradient for the last rye_draw of this renderer, whose cloud must still have its arrays with
 * the same numbers; camera and background are kept. */
RYE_API rye_status rye_draw_gradient(rye_renderer* renderer, const rye_cloud* cloud,
                                     const rye_image_gradient* image, rye_cloud_gradient* gradient);

/* ---- an avatar file ------------------------------------------------------------------------- */

typedef struct rye_avatar rye_avatar;

/* What moves an avatar. */
typedef struct rye_drivers {
    uint32_t struct_size;
    int32_t expression_count; /* as rye_avatar_info says */
    const float* expression;  /* coefficients */
    float gaze[2][2];         /* (pitch, yaw) of the left and the right eye; up and left are + */
    float pose[6];            /* of the head: axis-angle, translation [world units] */
    float scale;              /* world units per canonical unit, positive */
} rye_drivers;

/* What an avatar is. Pointers are valid until it is closed. */
typedef struct rye_avatar_info {
    uint32_t struct_size;
    int32_t expression_count;
    int32_t channels;
    int32_t visual_axes;           /* 1: gazes are visual axes; 0: optical ones */
    int64_t gaussians;
    const char* name;              /* UTF-8, may be empty */
    const float* background;       /* that of training, `channels` numbers */
    const float* expression_low;   /* ranges of the training frames */
    const float* expression_high;
    const char* const* expression_names; /* or null */
    float gaze_low[2][2], gaze_high[2][2];
    float eye[2][3];               /* neutral centres of the eyeballs [canonical units] */
    float head[3];                 /* middle of the head at the neutral drivers [world units] */
    float radius;                  /* of a sphere about it that holds nine tenths of the Gaussians */
} rye_avatar_info;

/* What the last picture took: caches compute only what differs from the one before. */
typedef struct rye_avatar_work {
    uint32_t struct_size;
    int32_t networks; /* evaluated */
    int64_t gaussians; /* that moved */
    int64_t tiles;     /* of the render, blended whole or in part */
    int64_t pixels;    /* of the picture, computed again */
} rye_avatar_work;

/* The network that turns a render of the Gaussians' features, `channels` numbers a pixel, into a
 * picture of 3, 2^doublings times as wide and high: 2 (doublings + 1) layers, each a 3 x 3
 * convolution over zeros beyond the border, InstanceNorm if `normalized`, and max(0, x). Every
 * second layer but the first one's input is doubled, bilinear, the corners' centres on each other.
 * Layers 2 i and 2 i + 1 give capacity 2^(doublings - i) numbers. Then z = out_weight x + out_bias,
 * and 1 / (1 + exp(-z)); with `skip`, b e^z / (b e^z + 1 - b), where b is the render's first three
 * numbers, doubled likewise and clamped to 0.001..0.999. A picture whose side is no multiple of
 * 2^doublings is cut from one that is, which the render covers from the first row and column on.
 * Arrays are valid until the avatar is closed. */
typedef struct rye_upsampler {
    uint32_t struct_size;
    int32_t channels, capacity, doublings, normalized, skip;
    const float* const* convolution; /* of a layer: for each place of the kernel, row by row, for
                                        each input, a number for each output */
    const float* out_weight;         /* 3 numbers for each of `capacity` */
    const float* out_bias;           /* 3 */
} rye_upsampler;

/* Where to write a picture, sRGB; null for the form not wanted. */
typedef struct rye_picture {
    uint32_t struct_size;
    float* rgb;    /* 3 W H in 0..1 */
    uint8_t* rgba; /* 4 W H, opaque */
} rye_picture;

/* Reads a file that `rye export --out NAME.avatar` wrote; options may be null. */
RYE_API rye_status rye_avatar_open(const char* path, const rye_options* options,
                                   rye_avatar** avatar);
/* The same of its bytes, which are copied; `name` begins messages. */
RYE_API rye_status rye_avatar_open_memory(const char* name, const void* bytes, size_t size,
                                          const rye_options* options, rye_avatar** avatar);
RYE_API void rye_avatar_close(rye_avatar* avatar); /* null does nothing */

RYE_API rye_status rye_avatar_describe(const rye_avatar* avatar, rye_avatar_info* info);

/* The frame that it is first shown at; drivers->expression points into the avatar. */
RYE_API rye_status rye_avatar_neutral(const rye_avatar* avatar, rye_drivers* drivers,
                                      rye_camera* camera);

/* Sets drivers->gaze so that both eyes look at a point of the world, by the axes that they are of;
 * the other drivers stay, and say where the eyes are. An eye stops `range` rad from straight ahead,
 * above 0 to 1.22. `missed` is null, or receives the angle [rad] by which the left and the right
 * eye look beside the point: 0 within their range. A point inside an eye is an error. */
RYE_API rye_status rye_avatar_gaze_at(rye_avatar* avatar, rye_drivers* drivers,
                                      const float point[3], float range, float* missed);

/* Lets the eyes live by themselves, `seconds` (0 to 3600) after they began: turns drivers->gaze by
 * glances and drift, and closes the lids in blinks by the coefficients whose names say so. The
 * coefficients are written to `expression`, which drivers->expression then is; null leaves the lids
 * as they are. An eye stops `range` rad from straight ahead, above 0 to 1.22. The same seed and
 * seconds give the same. */
RYE_API rye_status rye_avatar_idle(rye_avatar* avatar, rye_drivers* drivers, float* expression,
                                   uint64_t seed, double seconds, float range);

/* Draws over `background`, `channels` numbers, or over that of training if it is null. Nothing that
 * the drivers, the camera and the background leave as it was is computed again. */
RYE_API rye_status rye_avatar_draw(rye_avatar* avatar, const rye_drivers* drivers,
                                   const rye_camera* camera, const float* background,
                                   rye_picture* picture);
/* Of the last picture, or of the last rye_avatar_drive. */
RYE_API rye_status rye_avatar_last_work(const rye_avatar* avatar, rye_avatar_work* work);
/* The Gaussians of the last picture or of the last rye_avatar_drive, in the world; arrays are valid
 * until the next one. */
RYE_API rye_status rye_avatar_gaussians(const rye_avatar* avatar, rye_cloud* cloud);

/* Sets the radii of the left and the right pupil over those at rest, 0.4 to 2, from the next
 * picture or rye_avatar_drive on; 1 until then. */
RYE_API rye_status rye_avatar_pupils(rye_avatar* avatar, const float ratio[2]);

/* Moves the Gaussians without a picture, for a program that draws them by itself, and the network
 * after them; the next rye_avatar_draw draws all of its picture. The camera is where highlights on
 * the eyes are seen from. */
RYE_API rye_status rye_avatar_drive(rye_avatar* avatar, const rye_drivers* drivers,
                                    const rye_camera* camera);
/* The dilation of the last picture or of the last rye_avatar_drive [px^2], in `dilation`: it grows
 * with the head's size in the picture, so that Gaussians stay as wide on the head as in training. */
RYE_API rye_status rye_avatar_dilation(const rye_avatar* avatar, float* dilation);
RYE_API rye_status rye_avatar_upsampler(const rye_avatar* avatar, rye_upsampler* upsampler);

#ifdef __cplusplus
}
#endif

#endif
