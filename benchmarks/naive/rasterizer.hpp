// SPDX-License-Identifier: Apache-2.0
/// benchmarks/naive/rasterizer.hpp: the yardstick: splatting as a good engineer writes it in a day.
/// Scalar, one thread, textbook structure: project, box of 16 px tiles, sort of (tile, depth) keys,
/// a loop over each pixel's list; backward from the last contribution to the first. Independent of
/// rye. Do not optimise it: ratios are quoted against it.
/// Source: Kerbl et al., "3D Gaussian Splatting", 2023, and its appendix on gradients.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <utility>
#include <vector>

namespace naive {

struct Camera {
    float fx, fy, cx, cy, near;
    int width, height;
    float r[3][3], t[3];                 ///< world to camera
};

struct Cloud {                           ///< also its gradient
    std::vector<float> mean, scale, rotation, opacity, colour;
};

struct Projected {
    float x, y, depth;
    float a, b, c;                       ///< inverse covariance
    float opacity;
    int x0, x1, y0, y1;                  ///< tiles
};

struct ProjectedGradient {
    float x, y, a, b, c, opacity;
};

struct Rasterizer {
    static constexpr int edge = 16;
    static constexpr float alpha_min = 1.0F / 255, alpha_max = 0.999F, stop = 1e-4F;

    std::vector<Projected> screen;
    std::vector<std::pair<std::uint64_t, std::uint32_t>> keys;
    std::vector<std::size_t> first;      ///< per tile, and the end
    std::vector<float> transmittance;    ///< final, per pixel
    std::vector<std::size_t> last;       ///< one past the last contribution, per pixel
    std::size_t evaluated = 0;           ///< evaluated pixel-Gaussian pairs
    std::size_t blended = 0;             ///< those of them that contributed

    static void rotation_matrix(const float* q, float m[3][3]) {
        const float n = 1 / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        const float w = q[0] * n, x = q[1] * n, y = q[2] * n, z = q[3] * n;
        m[0][0] = 1 - 2 * (y * y + z * z), m[0][1] = 2 * (x * y - w * z);
        m[0][2] = 2 * (x * z + w * y), m[1][0] = 2 * (x * y + w * z);
        m[1][1] = 1 - 2 * (x * x + z * z), m[1][2] = 2 * (y * z - w * x);
        m[2][0] = 2 * (x * z - w * y), m[2][1] = 2 * (y * z + w * x);
        m[2][2] = 1 - 2 * (x * x + y * y);
    }

    /// Intermediate values of projection and its derivative.
    struct Linear {
        float p[3], rot[3][3], j[2][3], jw[2][3], m[2][3];  ///< m = J W R
        float tx, ty;
        bool free_x, free_y;
    };
    static Linear linearise(const Cloud& g, std::size_t i, const Camera& cam) {
        Linear l;
        for (int k = 0; k < 3; ++k) {
            l.p[k] = cam.t[k];
            for (int c = 0; c < 3; ++c) l.p[k] += cam.r[k][c] * g.mean[3 * i + std::size_t(c)];
        }
        const float z = l.p[2];
        const float lim_x0 = (-cam.cx - 0.15F * float(cam.width)) / cam.fx;
        const float lim_x1 = (float(cam.width) - cam.cx + 0.15F * float(cam.width)) / cam.fx;
        const float lim_y0 = (-cam.cy - 0.15F * float(cam.height)) / cam.fy;
        const float lim_y1 = (float(cam.height) - cam.cy + 0.15F * float(cam.height)) / cam.fy;
        l.tx = std::clamp(l.p[0] / z, lim_x0, lim_x1);
        l.ty = std::clamp(l.p[1] / z, lim_y0, lim_y1);
        l.free_x = l.tx == l.p[0] / z, l.free_y = l.ty == l.p[1] / z;
        l.j[0][0] = cam.fx / z, l.j[0][1] = 0, l.j[0][2] = -cam.fx * l.tx / z;
        l.j[1][0] = 0, l.j[1][1] = cam.fy / z, l.j[1][2] = -cam.fy * l.ty / z;
        rotation_matrix(&g.rotation[4 * i], l.rot);
        for (int r = 0; r < 2; ++r)
            for (int c = 0; c < 3; ++c) {
                l.jw[r][c] = 0;
                for (int k = 0; k < 3; ++k) l.jw[r][c] += l.j[r][k] * cam.r[k][c];
            }
        for (int r = 0; r < 2; ++r)
            for (int c = 0; c < 3; ++c) {
                l.m[r][c] = 0;
                for (int k = 0; k < 3; ++k) l.m[r][c] += l.jw[r][k] * l.rot[k][c];
            }
        return l;
    }
    static void covariance(const Cloud& g, std::size_t i, const Linear& l, float& xx, float& xy,
                           float& yy) {
        xx = yy = 0.3F;
        xy = 0;
        for (int k = 0; k < 3; ++k) {
            const float s2 = g.scale[3 * i + std::size_t(k)] * g.scale[3 * i + std::size_t(k)];
            xx += l.m[0][k] * l.m[0][k] * s2;
            xy += l.m[0][k] * l.m[1][k] * s2;
            yy += l.m[1][k] * l.m[1][k] * s2;
        }
    }

    void forward(const Cloud& g, const Camera& cam, int channels, std::vector<float>& image) {
        const std::size_t n = g.opacity.size();
        const int tx = (cam.width + edge - 1) / edge, ty = (cam.height + edge - 1) / edge;
        screen.resize(n);
        keys.clear();
        for (std::size_t i = 0; i < n; ++i) {
            Projected& s = screen[i];
            s.x0 = s.x1 = s.y0 = s.y1 = 0;
            const Linear l = linearise(g, i, cam);
            if (l.p[2] <= cam.near) continue;
            float xx, xy, yy;
            covariance(g, i, l, xx, xy, yy);
            const float det = xx * yy - xy * xy;
            s.x = cam.fx * l.p[0] / l.p[2] + cam.cx;
            s.y = cam.fy * l.p[1] / l.p[2] + cam.cy;
            s.depth = l.p[2];
            s.a = yy / det, s.b = -xy / det, s.c = xx / det;
            s.opacity = g.opacity[i];
            const float rx = 3.33F * std::sqrt(xx), ry = 3.33F * std::sqrt(yy);
            s.x0 = std::clamp(int(std::floor((s.x - rx) / edge)), 0, tx);
            s.x1 = std::clamp(int(std::floor((s.x + rx) / edge)) + 1, 0, tx);
            s.y0 = std::clamp(int(std::floor((s.y - ry) / edge)), 0, ty);
            s.y1 = std::clamp(int(std::floor((s.y + ry) / edge)) + 1, 0, ty);
            std::uint32_t depth_bits;
            std::memcpy(&depth_bits, &s.depth, sizeof depth_bits);
            for (int y = s.y0; y < s.y1; ++y)
                for (int x = s.x0; x < s.x1; ++x)
                    keys.emplace_back((std::uint64_t(y * tx + x) << 32U) | depth_bits,
                                      std::uint32_t(i));
        }
        std::sort(keys.begin(), keys.end());
        first.assign(std::size_t(tx * ty) + 1, 0);
        for (const auto& k : keys) ++first[std::size_t(k.first >> 32U) + 1];
        for (std::size_t t = 1; t < first.size(); ++t) first[t] += first[t - 1];

        const auto pixels = std::size_t(cam.width) * std::size_t(cam.height);
        image.assign(pixels * std::size_t(channels), 0);
        transmittance.assign(pixels, 1);
        last.assign(pixels, 0);
        evaluated = blended = 0;
        each_pixel(cam, [&](std::size_t tile, int x, int y, std::size_t p) {
            float* out = &image[p * std::size_t(channels)];
            float t = 1;
            std::size_t end = first[tile], k = first[tile];
            for (; k < first[tile + 1]; ++k) {
                const Projected& s = screen[keys[k].second];
                const float dx = float(x) + 0.5F - s.x, dy = float(y) + 0.5F - s.y;
                const float sigma = 0.5F * (s.a * dx * dx + s.c * dy * dy) + s.b * dx * dy;
                const float alpha = std::min(alpha_max, s.opacity * std::exp(-sigma));
                if (alpha < alpha_min) continue;
                if (t * (1 - alpha) < stop) break;
                const float* colour = &g.colour[keys[k].second * std::size_t(channels)];
                for (int c = 0; c < channels; ++c) out[c] += t * alpha * colour[c];
                t *= 1 - alpha;
                end = k + 1;
                ++blended;
            }
            evaluated += k - first[tile];
            transmittance[p] = t;
            last[p] = end;
        });
    }

    /// Gradients of all arrays of the cloud; after forward with the same arguments.
    void backward(const Cloud& g, const Camera& cam, int channels,
                  const std::vector<float>& g_image, Cloud& out) {
        const std::size_t n = g.opacity.size();
        out.mean.assign(3 * n, 0);
        out.scale.assign(3 * n, 0);
        out.rotation.assign(4 * n, 0);
        out.opacity.assign(n, 0);
        out.colour.assign(n * std::size_t(channels), 0);
        std::vector<ProjectedGradient> gs(n, ProjectedGradient{0, 0, 0, 0, 0, 0});
        each_pixel(cam, [&](std::size_t tile, int x, int y, std::size_t p) {
            const float* gp = &g_image[p * std::size_t(channels)];
            float t = transmittance[p];
            float behind = 0;        // <g, colour composited behind this contribution>
            for (std::size_t k = last[p]; k-- > first[tile];) {
                const std::size_t i = keys[k].second;
                const Projected& s = screen[i];
                const float dx = float(x) + 0.5F - s.x, dy = float(y) + 0.5F - s.y;
                const float sigma = 0.5F * (s.a * dx * dx + s.c * dy * dy) + s.b * dx * dy;
                const float bell = std::exp(-sigma);
                const float alpha = std::min(alpha_max, s.opacity * bell);
                if (alpha < alpha_min) continue;
                t /= 1 - alpha;
                const float* colour = &g.colour[i * std::size_t(channels)];
                float* gc = &out.colour[i * std::size_t(channels)];
                float along = 0;
                for (int c = 0; c < channels; ++c) {
                    along += gp[c] * colour[c];
                    gc[c] += t * alpha * gp[c];
                }
                const float g_alpha = t * (along - behind);
                behind += alpha * (along - behind);
                if (s.opacity * bell > alpha_max) continue;
                ProjectedGradient& d = gs[i];
                d.opacity += g_alpha * bell;
                const float g_sigma = -g_alpha * alpha;
                d.x -= g_sigma * (s.a * dx + s.b * dy);
                d.y -= g_sigma * (s.b * dx + s.c * dy);
                d.a += g_sigma * 0.5F * dx * dx;
                d.b += g_sigma * dx * dy;
                d.c += g_sigma * 0.5F * dy * dy;
            }
        });
        for (std::size_t i = 0; i < n; ++i)
            if (screen[i].x0 < screen[i].x1 && screen[i].y0 < screen[i].y1)
                project_backward(g, i, cam, gs[i], out);
    }

  private:
    /// f(tile, x, y, pixel), tile by tile.
    template <class F>
    static void each_pixel(const Camera& cam, F&& f) {
        std::size_t tile = 0;
        for (int y0 = 0; y0 < cam.height; y0 += edge)
            for (int x0 = 0; x0 < cam.width; x0 += edge, ++tile)
                for (int y = y0; y < std::min(cam.height, y0 + edge); ++y)
                    for (int x = x0; x < std::min(cam.width, x0 + edge); ++x)
                        f(tile, x, y, std::size_t(y) * std::size_t(cam.width) + std::size_t(x));
    }

    void project_backward(const Cloud& g, std::size_t i, const Camera& cam,
                          const ProjectedGradient& d, Cloud& out) const {
        const Linear l = linearise(g, i, cam);
        const Projected& s = screen[i];
        out.opacity[i] = d.opacity;
        // Of the covariance: -inverse * g * inverse, b being the one off-diagonal variable.
        const float hb = 0.5F * d.b;
        const float ma = s.a * d.a + s.b * hb, mb = s.a * hb + s.b * d.c;
        const float mc = s.b * d.a + s.c * hb, md = s.b * hb + s.c * d.c;
        const float g_xx = -(ma * s.a + mb * s.b), g_xy = -(ma * s.b + mb * s.c);
        const float g_yy = -(mc * s.b + md * s.c);
        float g_m[2][3], g_jw[2][3] = {}, g_rot[3][3];
        for (std::size_t k = 0; k < 3; ++k) {
            const float sc = g.scale[3 * i + k], mx = l.m[0][k], my = l.m[1][k];
            out.scale[3 * i + k] =
                2 * sc * (g_xx * mx * mx + 2 * g_xy * mx * my + g_yy * my * my);
            g_m[0][k] = 2 * sc * sc * (g_xx * mx + g_xy * my);
            g_m[1][k] = 2 * sc * sc * (g_xy * mx + g_yy * my);
        }
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) {
                g_rot[r][c] = l.jw[0][r] * g_m[0][c] + l.jw[1][r] * g_m[1][c];
                for (int k = 0; k < 2; ++k) g_jw[k][r] += g_m[k][c] * l.rot[r][c];
            }
        float g_j[2][3] = {};
        for (int r = 0; r < 2; ++r)
            for (int c = 0; c < 3; ++c)
                for (int k = 0; k < 3; ++k) g_j[r][c] += g_jw[r][k] * cam.r[c][k];
        const float z = l.p[2], iz = 1 / z;
        float gp[3] = {cam.fx * iz * d.x, cam.fy * iz * d.y,
                       -(cam.fx * l.p[0] * d.x + cam.fy * l.p[1] * d.y) * iz * iz};
        gp[2] -= (cam.fx * g_j[0][0] + cam.fy * g_j[1][1]) * iz * iz;
        const float gx = -cam.fx * iz * g_j[0][2], gy = -cam.fy * iz * g_j[1][2];
        gp[2] += (cam.fx * l.tx * g_j[0][2] + cam.fy * l.ty * g_j[1][2]) * iz * iz;
        if (l.free_x) gp[0] += gx * iz, gp[2] -= gx * l.p[0] * iz * iz;
        if (l.free_y) gp[1] += gy * iz, gp[2] -= gy * l.p[1] * iz * iz;
        for (std::size_t c = 0; c < 3; ++c)
            for (int k = 0; k < 3; ++k) out.mean[3 * i + c] += cam.r[k][c] * gp[k];
        rotation_backward(&g.rotation[4 * i], g_rot, &out.rotation[4 * i]);
    }

    static void rotation_backward(const float* q, const float g[3][3], float* out) {
        const float n = 1 / std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        const float w = q[0] * n, x = q[1] * n, y = q[2] * n, z = q[3] * n;
        const float gw = 2 * (x * (g[2][1] - g[1][2]) + y * (g[0][2] - g[2][0]) +
                              z * (g[1][0] - g[0][1]));
        const float gx = 2 * (-2 * x * (g[1][1] + g[2][2]) + y * (g[0][1] + g[1][0]) +
                              z * (g[0][2] + g[2][0]) + w * (g[2][1] - g[1][2]));
        const float gy = 2 * (x * (g[0][1] + g[1][0]) - 2 * y * (g[0][0] + g[2][2]) +
                              z * (g[1][2] + g[2][1]) + w * (g[0][2] - g[2][0]));
        const float gz = 2 * (x * (g[0][2] + g[2][0]) + y * (g[1][2] + g[2][1]) -
                              2 * z * (g[0][0] + g[1][1]) + w * (g[1][0] - g[0][1]));
        const float along = w * gw + x * gx + y * gy + z * gz;
        out[0] = n * (gw - along * w), out[1] = n * (gx - along * x);
        out[2] = n * (gy - along * y), out[3] = n * (gz - along * z);
    }
};

} // namespace naive
