/* SPDX-License-Identifier: Apache-2.0 */
/* rye/c/device.h: rye for programs in C, and for languages that call C, whose arrays are in the
 * memory of a CUDA device: images of a cloud of 3D Gaussians and their gradients, on the caller's
 * stream, from the caller's arrays, with the caller's memory. Errors, versions and conventions are
 * those of rye/c/rye.h, but for rye_device_message; the library is rye_device, built where nvcc is (-DRYE_CUDA=ON).
 *
 * Waiting. Nothing here waits for the device but rye_device_finish, if it is told to. How much
 * memory a frame needs is known once it is drawn: a frame that did not fit has NaN in all its
 * pixels and gradients, rye_device_finish says so and makes room, and the frame is drawn again.
 *
 * Bits. The same input gives the same bits, for images and for gradients.
 *
 * Threads. A renderer and its frames belong to one thread at a time. All run on the device that is
 * current for the calling thread. */
#ifndef RYE_C_DEVICE_H
#define RYE_C_DEVICE_H

#include <rye/c/rye.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What is added to a Gaussian's size on the screen, so that it is not lost between pixels. */
typedef enum rye_antialias {
    RYE_ANTIALIAS_DILATE = 0, /* a variance along both axes */
    RYE_ANTIALIAS_MIP = 1     /* the same, with an opacity that keeps the sum over pixels */
} rye_antialias;

/* Settings of a renderer. */
typedef struct rye_device_options {
    uint32_t struct_size;
    int32_t accuracy;  /* a rye_accuracy */
    int32_t antialias; /* a rye_antialias */
    float dilation;    /* the variance [px^2]; 0: 0.3; negative: none */
    /* Where frames get their memory from; if both are null, from CUDA's pool. `allocate` returns
     * null if it fails. The memory is used on `stream` alone. */
    void* context;
    void* (*allocate)(void* context, size_t bytes, void* stream);
    void (*release)(void* context, void* memory, void* stream);
} rye_device_options;

/* N Gaussians with C channels, or with harmonics, in device memory, read without a copy. */
typedef struct rye_device_cloud {
    uint32_t struct_size;
    int32_t channels;       /* C, 1 to 1024; 3 with harmonics */
    int64_t count;          /* N */
    const float* mean;      /* 3 N [world units] */
    const float* rotation;  /* 4 N, (w, x, y, z) of any norm but 0 */
    const float* scale;     /* 3 N, standard deviations along the own axes [world units] */
    const float* opacity;   /* N, in 0..1 */
    const float* feature;   /* C N; null with harmonics */
    const float* harmonics; /* 3 K N: K triples of red, green and blue; or null */
    int32_t bases;          /* K, from (degree + 1)^2 on; those above the degree are not read */
    int32_t degree;         /* 0 to 4 */
} rye_device_cloud;

/* Where to write images, in device memory. Sizes are the camera's W x H. */
typedef struct rye_device_image {
    uint32_t struct_size;
    float* feature; /* C W H */
    float* alpha;   /* W H, in 0..1 */
} rye_device_image;

/* Gradients of a loss with respect to the images; alpha may be null. */
typedef struct rye_device_image_gradient {
    uint32_t struct_size;
    const float *feature, *alpha;
} rye_device_image_gradient;

/* Where to write those with respect to the cloud and the background; null for those not wanted. */
typedef struct rye_device_cloud_gradient {
    uint32_t struct_size;
    float *mean, *rotation, *scale, *opacity, *feature, *harmonics; /* as the cloud's */
    float* background;                                              /* C */
} rye_device_cloud_gradient;

/* What a frame took. */
typedef struct rye_device_cost {
    uint32_t struct_size;
    int32_t fits;           /* 1; 0: it must be drawn again; -1: not known yet */
    int64_t entries, groups; /* pairs of a tile and a Gaussian; groups of 16 visits */
    int64_t skipped;        /* Gaussians not drawn for a number that is not finite */
    int64_t bytes;          /* of the frame's memory */
} rye_device_cost;

typedef struct rye_device_renderer rye_device_renderer; /* settings, and its frames' memory */
typedef struct rye_device_frame rye_device_frame;       /* a picture, kept for its gradient */

/* rye_message() of this library. */
RYE_API const char* rye_device_message(void);

/* 0; 1 if the library was compiled for the host, for tests: its device memory is the host's. */
RYE_API int32_t rye_device_is_host(void);

/* options may be null. */
RYE_API rye_status rye_device_renderer_create(const rye_device_options* options,
                                              rye_device_renderer** renderer);
/* After its frames; null does nothing. */
RYE_API void rye_device_renderer_destroy(rye_device_renderer* renderer);

RYE_API rye_status rye_device_frame_create(rye_device_renderer* renderer,
                                           rye_device_frame** frame);
RYE_API void rye_device_frame_destroy(rye_device_frame* frame); /* null does nothing */

/* The least room that the frame has when it is drawn next, as another frame's cost says. */
RYE_API rye_status rye_device_frame_room(rye_device_frame* frame, int64_t entries, int64_t groups);

/* Puts the drawing of a cloud over `background` (C numbers in device memory; null: zeros) on the
 * stream, a cudaStream_t. With gradient = 0 the frame keeps nothing for rye_device_gradient. */
RYE_API rye_status rye_device_draw(rye_device_frame* frame, const rye_device_cloud* cloud,
                                   const rye_camera* camera, const float* background,
                                   const rye_device_image* image, int32_t gradient, void* stream);

/* What the last rye_device_draw took: waits for it if wait is not 0. If the frame did not fit, it
 * has room afterwards. Of a frame in a CUDA graph that is what its last launch took, and known only
 * to who waits. */
RYE_API rye_status rye_device_finish(rye_device_frame* frame, int32_t wait, rye_device_cost* cost);

/* Puts the gradient for the last rye_device_draw of this frame on the same stream. The cloud must
 * still have its arrays with the same numbers; camera and background are kept. */
RYE_API rye_status rye_device_gradient(rye_device_frame* frame, const rye_device_cloud* cloud,
                                       const rye_device_image_gradient* image,
                                       const rye_device_cloud_gradient* gradient);

#ifdef __cplusplus
}
#endif

#endif
