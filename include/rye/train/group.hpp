// SPDX-License-Identifier: Apache-2.0
/// rye/train/group.hpp: ranks that train one avatar together. Each has the whole avatar and takes
/// its own pictures of a step; what the step's pictures ask for is added over all ranks before the
/// optimiser moves anything, so that all ranks move alike. Sums follow a fixed tree of pictures,
/// and so of ranks: with 2^k pictures a step, 1, 2, ... 2^k ranks give the same bits.
/// ThreadGroup (train/thread_group.hpp) has its ranks in threads of one process, NcclRanks
/// (train/cuda/nccl_ranks.hpp) has one a GPU.
#pragma once

#include <concepts>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include <rye/core/config.hpp>
#include <rye/core/error.hpp>
#include <rye/core/fields.hpp>

namespace rye {

namespace detail {

/// Arrays of one rank that are added to the same arrays of the others.
template <class T>
using GroupArrays = std::vector<std::span<T>>;

} // namespace detail

/// A rank's end of a group. sum(arrays) replaces every number by its sum over all ranks, added as
/// tree_sum adds, and returns when all ranks have theirs; it throws an Error if another rank has
/// ended.
template <class G>
concept Group = requires(G& g, const detail::GroupArrays<float>& arrays) {
    { g.rank() } -> std::convertible_to<int>;
    { g.size() } -> std::convertible_to<int>;
    g.sum(arrays);
};

/// A group of one, for which nothing is done.
struct Alone {
    static constexpr int rank() { return 0; }
    static constexpr int size() { return 1; }
    template <class Arrays>
    static constexpr void sum(const Arrays&) {}
};
static_assert(Group<Alone>);

/// Pictures of a step that one rank takes: [first, first + count) of `all`.
struct StepShare {
    Index first = 0, count = 1, all = 1;
};

/// How ranks add up.
enum class RankSum {
    tree,   ///< by tree_sum: the same bits for 1, 2, 4, ... ranks
    library ///< in the order of the library that joins the devices, which promises none
};

/// Returns a rank's share of the pictures of a step: successive ones, as many as others take or
/// one less or more. Throws an Error if there are fewer pictures than ranks.
inline StepShare step_share(Index all, int rank, int size) {
    require(size >= 1 && rank >= 0 && rank < size, "step_share", "got rank ", rank, " of ", size,
            ", expected a rank from 0 to ", size - 1);
    require(all >= size, "step_share", "a step shows ", all, " pictures, expected ", size,
            " or more, one for each rank");
    const Index first = all * rank / size;
    return {first, all * (rank + 1) / size - first, all};
}

/// Adds numbers in place as a tree: x[0] += x[1], x[2] += x[3], ..., then x[0] += x[2], ... until
/// x[0] has the sum of all. add(i, k) adds x[k] to x[i].
template <class Add>
void tree_sum(int count, const Add& add) {
    for (int stride = 1; stride < count; stride *= 2)
        for (int i = 0; i + stride < count; i += 2 * stride) add(i, i + stride);
}

/// Order in which sums arrive one after another, so that they end as tree_sum has them, with room
/// for about log2 of their number. put(level) writes the next number at a level, join(level) adds
/// that of level + 1 to that of `level`; the sum is at level 0 after close().
class TreeLevels {
  public:
    template <class Put, class Join>
    void add(const Put& put, const Join& join) {
        put(open_++);
        for (Index n = ++count_; n % 2 == 0; n /= 2) join(--open_ - 1);
    }
    template <class Join>
    void close(const Join& join) {
        while (open_ > 1) join(--open_ - 1);
        open_ = 0, count_ = 0;
    }
    /// Returns the number of levels of so many numbers.
    static int levels(Index count) {
        int n = 1;
        while ((Index(1) << (n - 1)) < count) ++n;
        return n;
    }
    Index count() const { return count_; }

  private:
    int open_ = 0;
    Index count_ = 0;
};

namespace detail {

/// Sums of gradients P and of losses L over the pictures of a step, the first term by term.
template <class P, class L>
class StepSums {
  public:
    /// Adds a picture's gradient and losses times `share`.
    template <class T>
    void add(const P& gradient, const L& losses, T share) {
        levels_.add(
            [&](int level) {
                if (static_cast<std::size_t>(level) == level_.size())
                    level_.push_back({gradient, losses});
                Level& own = level_[static_cast<std::size_t>(level)];
                P::fields([&](const std::string&, auto& a, const auto& g) { a = share * g; },
                          own.gradient, gradient);
                L::fields([&](const char*, auto& a, const auto& l) { a = share * l; }, own.losses,
                          losses);
            },
            [&](int level) { join(level); });
    }
    /// Adds up what was added, over all ranks of the group, and begins anew; returns the sums.
    template <class T, class G>
    std::pair<P&, L&> close(G& group) {
        levels_.close([&](int level) { join(level); });
        Level& sum = level_.front();
        GroupArrays<T> arrays;
        P::fields(
            [&](const std::string&, auto& a) {
                arrays.push_back({a.data(), static_cast<std::size_t>(a.size())});
            },
            sum.gradient);
        L::fields([&](const char*, auto& a) { arrays.push_back({&a, 1}); }, sum.losses);
        group.sum(arrays);
        return {sum.gradient, sum.losses};
    }
    Index count() const { return levels_.count(); }

  private:
    struct Level {
        P gradient;
        L losses;
    };
    void join(int level) {
        Level& to = level_[static_cast<std::size_t>(level)];
        const Level& from = level_[static_cast<std::size_t>(level) + 1];
        add_fields(to.gradient, from.gradient);
        L::fields([](const char*, auto& a, const auto& b) { a += b; }, to.losses, from.losses);
    }

    TreeLevels levels_;
    std::vector<Level> level_;
};

} // namespace detail

} // namespace rye
