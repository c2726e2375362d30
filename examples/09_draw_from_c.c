/* SPDX-License-Identifier: Apache-2.0 */
/* Lesson 9: rye from C. Draws a Gaussian, checks a gradient of the image by a central difference,
 * and, given an avatar file (`rye export --run RUN --out NAME.avatar`), draws it with its eyes
 * turned to a PPM image:  lesson_09_draw_from_c NAME.avatar picture.ppm */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include <rye/c/rye.h>

static void check(rye_status status) {
    if (status == RYE_OK) return;
    fprintf(stderr, "rye: %s\n", rye_message());
    exit(1);
}

static int draw_avatar(const char* path, const char* out) {
    rye_avatar* avatar = NULL;
    rye_drivers drivers = RYE_INIT(rye_drivers);
    rye_camera camera = RYE_INIT(rye_camera);
    rye_picture picture = RYE_INIT(rye_picture);
    check(rye_avatar_open(path, NULL, &avatar));
    check(rye_avatar_neutral(avatar, &drivers, &camera));
    for (int eye = 0; eye < 2; ++eye) drivers.gaze[eye][1] = 0.3f; /* to the subject's left */
    const size_t pixels = (size_t)camera.width * (size_t)camera.height;
    picture.rgba = malloc(4 * pixels);
    if (picture.rgba == NULL) return 1;
    check(rye_avatar_draw(avatar, &drivers, &camera, NULL, &picture));
    FILE* file = fopen(out, "wb");
    if (file == NULL) return perror(out), 1;
    fprintf(file, "P6\n%d %d\n255\n", (int)camera.width, (int)camera.height);
    for (size_t i = 0; i < pixels; ++i) fwrite(picture.rgba + 4 * i, 1, 3, file);
    free(picture.rgba);
    rye_avatar_close(avatar);
    return fclose(file) == 0 ? 0 : 1;
}

int main(int count, char** words) {
    if (count == 3) return draw_avatar(words[1], words[2]);
    float mean[3] = {0, 0, 0}, rotation[4] = {1, 0, 0, 0}, scale[3] = {0.3f, 0.1f, 0.1f},
          opacity[1] = {0.9f}, feature[3] = {1.0f, 0.5f, 0.1f};
    rye_cloud cloud = RYE_INIT(rye_cloud);
    cloud.count = 1, cloud.channels = 3;
    cloud.mean = mean, cloud.rotation = rotation, cloud.scale = scale;
    cloud.opacity = opacity, cloud.feature = feature;

    rye_look look = RYE_INIT(rye_look);
    look.eye[2] = 4, look.up[1] = 1, look.vertical_fov = 0.5f, look.width = look.height = 64;
    rye_camera camera = RYE_INIT(rye_camera);
    check(rye_camera_look_at(&look, &camera));

    static float pixels[3 * 64 * 64];
    const float black[3] = {0, 0, 0};
    rye_renderer* renderer = NULL;
    rye_image image = RYE_INIT(rye_image);
    image.feature = pixels;
    check(rye_renderer_create(NULL, &renderer));
    check(rye_draw(renderer, &cloud, &camera, black, &image));
    printf("red in the middle %.3f\n", pixels[3 * (32 * 64 + 32)]);

    /* The loss is half the sum of squares, so its gradient with respect to the image is the image. */
    float g_opacity[1];
    rye_image_gradient g_image = RYE_INIT(rye_image_gradient);
    rye_cloud_gradient g_cloud = RYE_INIT(rye_cloud_gradient);
    g_image.feature = pixels, g_cloud.opacity = g_opacity;
    check(rye_draw_gradient(renderer, &cloud, &g_image, &g_cloud));
    double loss[2] = {0, 0};
    const float step = 1e-2f;
    for (int side = 0; side < 2; ++side) {
        opacity[0] = side == 0 ? 0.9f - step : 0.9f + step;
        check(rye_draw(renderer, &cloud, &camera, black, &image));
        for (int i = 0; i < 3 * 64 * 64; ++i) loss[side] += 0.5 * (double)pixels[i] * pixels[i];
    }
    const double difference = (loss[1] - loss[0]) / (2 * (double)step);
    printf("d loss / d opacity %.3f, by differences %.3f\n", (double)g_opacity[0], difference);
    rye_renderer_destroy(renderer);
    return fabs(difference - (double)g_opacity[0]) < 1e-2 * fabs(difference) ? 0 : 1;
}
