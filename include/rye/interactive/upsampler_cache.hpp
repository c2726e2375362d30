// SPDX-License-Identifier: Apache-2.0
/// rye/interactive/upsampler_cache.hpp: incremental super-resolution. A 3 x 3 convolution spreads a
/// change by one pixel, so only the changed region, grown by one pixel per layer, is convolved
/// again, and every bit is that of upsampler_forward. This requires a network without InstanceNorm,
/// whose mean and variance depend on every pixel, and without doublings, whose weights depend on
/// the position in the image. Other networks run whole (see is_local). Memory: the output of every
/// layer, and the image.
#pragma once

#include <vector>

#include <rye/core/region.hpp>
#include <rye/nn/upsampler.hpp>

namespace rye::detail {

/// Returns true if a change of the input affects only pixels nearby.
inline bool is_local(const UpsamplerShape& s) {
    return s.norm == Normalization::none && s.doublings == 0;
}

/// Upsampled image that is updated around the changed pixels of its input.
template <Backend B, Real T>
class UpsamplerCache {
  public:
    explicit UpsamplerCache(const B& backend = {}) : backend_(backend) {}

    /// Computes the whole image.
    const Image<T>& draw(const Upsampler<T>& u, const Image<T>& in) {
        if (is_local(u.shape)) {
            out_ = upsampler_forward(backend_, u, in, &trace_);
            trace_.out = {};
        } else {
            out_ = upsampler_forward(backend_, u, in, nullptr);
        }
        pixels_ = out_.size();
        return out_;
    }

    /// Updates the image to an input that differs from the last one only in `changed`.
    const Image<T>& redraw(const Upsampler<T>& u, const Image<T>& in, const Region& changed) {
        pixels_ = 0;
        if (changed.empty()) return out_;
        if (!is_local(u.shape)) return draw(u, in);
        require(out_.width == in.width && out_.height == in.height &&
                    changed.width() == in.width && changed.height() == in.height,
                "UpsamplerCache",
                "the image or the region differs in size from the last image; call draw() first");
        Region region = changed;
        for (int l = 0; l < u.shape.layers(); ++l) region = convolve(u, in, l, region);
        last_layer(u, in, region);
        return out_;
    }

    const Image<T>& picture() const { return out_; }
    /// Returns the number of pixels that the last call recomputed.
    Index pixels() const { return pixels_; }

    std::size_t bytes() const {
        Index numbers = out_.pixels.size() + trace_.base.pixels.size();
        for (const Image<T>& i : trace_.normal) numbers += i.pixels.size();
        return static_cast<std::size_t>(numbers) * sizeof(T);
    }

  private:
    /// Convolves layer l where its input changed; returns the region where its output changed.
    Region convolve(const Upsampler<T>& u, const Image<T>& in, int l, const Region& changed) {
        const auto i = static_cast<std::size_t>(l);
        Image<T>& to = trace_.normal[i];
        const Columns<T>& weight = u.conv[i];
        const Image<T>& from = l == 0 ? in : trace_.normal[i - 1];
        // A matrix product may round a column by its position: without lanes, convolve whole rows.
        const bool lanes = detail::runs_in_lanes<B, T>(weight.rows(), from.channels(), to.width);
        Region region = changed.grown(narrowest);
        region.widen(lanes ? narrowest : to.width);
        for (const rye::Window& w : region.bands()) {
            const Padded<T> input =
                l == 0 ? cut(from, w, [](const auto& x) { return x; })
                       : cut(from, w, [](const auto& x) { return relu(x); });
            const Image<T> part = convolve3x3(backend_, weight, input);
            const Index c = to.pixels.rows();
            for (int y = 0; y < part.height; ++y)
                std::copy_n(part.pixels.data() + Index(y) * part.width * c, part.width * c,
                            to.pixels.data() + (Index(w.top + y) * to.width + w.left) * c);
        }
        return region;
    }

    /// Width below which windows are not convolved in lanes.
    static constexpr int narrowest = 8;

    /// Returns f(pixel) of a window and its neighbours, zeros outside the image.
    template <class F>
    static Padded<T> cut(const Image<T>& image, const rye::Window& w, const F& f) {
        const Index c = image.channels(), pitch = w.width() + 2;
        Padded<T> out{w.width(), w.height(), Columns<T>(c, pitch * (w.height() + 2))};
        const int left = std::max(0, w.left - 1), right = std::min(image.width, w.right + 1);
        for (int y = w.top - 1; y <= w.bottom; ++y) {
            T* const row = out.pixels.data() + (y - w.top + 1) * pitch * c;
            if (y < 0 || y >= image.height) {
                std::fill_n(row, pitch * c, T(0));
                continue;
            }
            if (w.left == 0) std::fill_n(row, c, T(0));
            if (w.right == image.width) std::fill_n(row + (pitch - 1) * c, c, T(0));
            transform_array<B>((right - left) * c, row + (left - w.left + 1) * c, f,
                               image.pixels.data() + (Index(y) * image.width + left) * c);
        }
        return out;
    }

    /// Computes the last layer. Its vectors, and the columns of its products, come in eights from
    /// the start of a chunk: runs of pixels that begin and end at multiples of eight have the bits
    /// of the whole chunk.
    void last_layer(const Upsampler<T>& u, const Image<T>& in, const Region& changed) {
        const Index n = out_.size(), grain = detail::last_layer_grain;
        runs_.clear();
        for (const rye::Window& w : changed.bands())
            for (int y = w.top; y < w.bottom; ++y) {
                const Index row = Index(y) * out_.width, end = row + w.right;
                for (Index b = row + w.left; b < end;) {
                    const Index chunk = b / grain * grain, stop = std::min(n, chunk + grain);
                    Index from = b / shortest * shortest, to = std::min(end, stop);
                    to = std::min(stop, (to + shortest - 1) / shortest * shortest);
                    if (stop - to < shortest) to = stop;
                    if (to - from < shortest) from = std::max(chunk, to - shortest);
                    b = to;
                    if (!runs_.empty() && runs_.back().end >= from && from > chunk)
                        runs_.back().end = to;
                    else
                        runs_.push_back({from, to});
                }
            }
        for_chunks(backend_.threads, static_cast<Index>(runs_.size()), 16,
                   [&](Index first, Index last, Index) {
                       for (Index k = first; k < last; ++k) {
                           const auto [b, e] = runs_[static_cast<std::size_t>(k)];
                           if (u.shape.skip)
                               trace_.base.pixels.middleCols(b, e - b) =
                                   in.pixels.middleCols(b, e - b).topRows(3);
                           detail::last_layer<B, T>(u, {trace_.normal.back(), trace_.base}, b, e,
                                                    out_);
                       }
                   });
        for (const Run& r : runs_) pixels_ += r.end - r.begin;
    }

    /// Run of pixels [begin, end) of one chunk.
    struct Run {
        Index begin, end;
    };
    /// Length below which products take another code path.
    static constexpr Index shortest = 16;

    UpsamplerTrace<T> trace_;
    B backend_;
    Image<T> out_;
    std::vector<Run> runs_;
    Index pixels_ = 0;
};

} // namespace rye::detail
