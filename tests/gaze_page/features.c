/* SPDX-License-Identifier: Apache-2.0 */
/* features.c: for webgpu.js, linked into the page that is tested: the features of the Gaussians
 * that page_drive moved, drawn by the headers at an accuracy of rye_accuracy. Null on failure. */
#include <stdlib.h>

#include <emscripten/emscripten.h>

#include <rye/c/rye.h>

extern const rye_cloud* page_cloud(void);
extern const rye_camera* page_render_camera(void);
extern float* page_background(void);

EMSCRIPTEN_KEEPALIVE const float* page_features(int accuracy) {
    static float* features;
    const rye_cloud* cloud = page_cloud();
    const rye_camera* camera = page_render_camera();
    rye_options options = RYE_INIT(rye_options);
    rye_image image = RYE_INIT(rye_image);
    rye_renderer* renderer = NULL;
    rye_status status;
    free(features);
    features = malloc(sizeof(float) * (size_t)cloud->channels * (size_t)camera->width *
                      (size_t)camera->height);
    if (features == NULL) return NULL;
    options.accuracy = accuracy;
    image.feature = features;
    status = rye_renderer_create(&options, &renderer);
    if (status == RYE_OK) status = rye_draw(renderer, cloud, camera, page_background(), &image);
    rye_renderer_destroy(renderer);
    return status == RYE_OK ? features : NULL;
}
