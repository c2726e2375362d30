/* SPDX-License-Identifier: Apache-2.0 */
/* tests/c/client.c: a client that a C11 compiler takes with every warning as an error. */
#include <rye/c/rye.h>

int c_client(const rye_cloud* cloud, const rye_camera* camera, float* pixels);

int c_client(const rye_cloud* cloud, const rye_camera* camera, float* pixels) {
    rye_renderer* renderer = NULL;
    rye_options options = RYE_INIT(rye_options);
    rye_image image = RYE_INIT(rye_image);
    const float black[5] = {0, 0, 0, 0, 0};
    options.threads = 2;
    options.accuracy = RYE_ACCURACY_BALANCED;
    image.feature = pixels;
    if (rye_renderer_create(&options, &renderer) != RYE_OK) return 1;
    if (rye_draw(renderer, cloud, camera, black, &image) != RYE_OK) return 2;
    rye_renderer_destroy(renderer);
    return rye_c_version() == RYE_C_VERSION ? 0 : 3;
}
