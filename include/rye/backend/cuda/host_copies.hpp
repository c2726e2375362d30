// SPDX-License-Identifier: Apache-2.0
/// rye/backend/cuda/host_copies.hpp: copies to shared memory that go on beside other work, as warps
/// of the host have them: there is no number (but NaN) until the batch of a copy is waited for.
#pragma once

#include <cstdint>
#include <cstring>
#include <vector>

#include <rye/backend/cuda/unrolled.hpp>
#include <rye/backend/cuda/warp_lanes.hpp>

namespace rye::detail {

/// The copies of a block's warps, which run in turn.
struct HostCopies {
    using U = Lanes<std::uint32_t>;
    using M = Lanes<bool>;

    /// Starts copies of 16 bytes, or of a number, in the lanes of the mask.
    static void copy4_ahead(const M& m, Quad4* to, const U& i, const Quad4* from, const U& k) {
        for (int l = 0; l < Lanes<int>::count; ++l)
            if (m.x[l]) ahead(to + i.x[l], from + k.x[l], sizeof(Quad4));
    }
    static void copy_ahead(const M& m, float* to, const U& i, const float* from, const U& k) {
        for (int l = 0; l < Lanes<int>::count; ++l)
            if (m.x[l]) ahead(to + i.x[l], from + k.x[l], sizeof(float));
    }
    /// Starts copies of 16 bytes in the lanes of the mask, of zeros in the others.
    static void copy4_or_zero(const M& m, Quad4* to, const U& i, const Quad4* from, const U& k) {
        static const Quad4 zero{0, 0, 0, 0};
        for (int l = 0; l < Lanes<int>::count; ++l)
            ahead(to + i.x[l], m.x[l] ? from + k.x[l] : &zero, sizeof(Quad4));
    }
    /// Ends a batch of copies; waits for all but the last `newer` batches.
    static void end_copies() { under_way().emplace_back(); }
    template <int newer = 1>
    static void wait_for_copies() {
        auto& batches = under_way(); // the last is open
        constexpr std::size_t kept = newer + 1;
        for (std::size_t b = 0; b + kept < batches.size(); ++b)
            for (const Copy& c : batches[b]) std::memcpy(c.to, c.from, c.bytes);
        if (batches.size() > kept)
            batches.erase(batches.begin(), batches.end() - std::ptrdiff_t(kept));
    }
    /// Drops the copies of a block that has ended.
    static void forget_copies() { under_way().assign(1, {}); }

  private:
    struct Copy {
        void* to;
        const void* from;
        std::size_t bytes;
    };
    using Batches = std::vector<std::vector<Copy>>;
    static Batches& under_way() {
        static thread_local Batches batches(1);
        return batches;
    }
    static void ahead(void* to, const void* from, std::size_t bytes) {
        std::memset(to, 0xFF, bytes);
        under_way().back().push_back({to, from, bytes});
    }
};

} // namespace rye::detail
