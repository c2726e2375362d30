// SPDX-License-Identifier: Apache-2.0
// The sort against the library's, for keys that spread, cluster and repeat; and lists: near to far,
// ties by index, independent of the number of threads.
#include <rye/splat/tile_lists.hpp>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>
#include <rye/splat/accuracy.hpp>

using namespace rye;

namespace {

template <class Key>
bool sorts_stably(std::vector<Key> keys) {
    std::vector<Keyed<Key>> x, buffer(keys.size());
    for (std::size_t i = 0; i < keys.size(); ++i)
        x.push_back({keys[i], static_cast<std::uint32_t>(i)});
    auto expected = x;
    std::stable_sort(expected.begin(), expected.end(),
                     [](const auto& a, const auto& b) { return a.key < b.key; });
    sort_by_key(x.data(), buffer.data(), static_cast<Index>(x.size()));
    bool same = true;
    for (std::size_t i = 0; i < x.size(); ++i)
        same &= x[i].key == expected[i].key && x[i].value == expected[i].value;
    return same;
}

template <class Key>
void check_sort() {
    constexpr Key top = ~Key(0);
    const Random random{1, 1};
    const auto bits = [&](std::size_t i) { return static_cast<Key>(random.bits(i) >> 7U); };
    for (const std::size_t n : {0U, 1U, 2U, 16U, 17U, 300U, 5000U, 70000U}) {
        std::vector<Key> spread, few, cluster, ends, falling;
        for (std::size_t i = 0; i < n; ++i) {
            spread.push_back(static_cast<Key>(bits(i) * Key(0x9E3779B97F4A7C15U)));
            few.push_back(bits(i) % 3);
            // All but two within a narrow range: the highest bits do not separate them.
            cluster.push_back(i == 1 ? top : i == 2 ? 0 : top / 2 + bits(i) % 4096);
            ends.push_back(bits(i) % 2 == 0 ? 0 : top);
            falling.push_back(static_cast<Key>(top - i));
        }
        for (const auto& keys : {spread, few, cluster, ends, falling}) CHECK(sorts_stably(keys));
    }
}

struct Members {
    std::vector<Footprint<float>> footprint;
    std::vector<detail::TileRows> rows;
    std::vector<std::uint32_t> key, index;

    Index count() const { return static_cast<Index>(rows.size()); }
    template <Threads P>
    TileLists lists(const P& threads) const {
        TileLists out;
        detail::BinScratch<std::uint32_t> scratch;
        const auto of = [](const auto& v) {
            return [&v](Index m) -> const auto& { return v[static_cast<std::size_t>(m)]; };
        };
        out.build<Support::ellipse, float>(
            threads, {96, 96},
            detail::BinInput{count(), of(rows), [&](Index m) { return key[std::size_t(m)]; },
                             of(index), of(footprint)},
            Index(1) << 30, scratch);
        return out;
    }
};

/// Enough entries to fill several chunks; some so high that their columns are not stored; few
/// different depths.
Members random_members() {
    const Random random{4, 1};
    Members m;
    for (std::uint64_t i = 0; i < 6000; ++i) {
        const auto u = [&](std::uint64_t k) { return random.uniform(8 * i + k); };
        const float s = i % 50 == 0 ? 30.0F : 2.0F;
        const Footprint<float> f{
            float(96 * u(0)), float(96 * u(1)), 3, {s * s, 0.2F * s * s, s * s}, 0.96F * s * s * s * s};
        const Cover<Support::ellipse, float> cover{f, 96, 96};
        detail::TileRows rows{};
        rows.begin = cover.rows().begin, rows.end = cover.rows().end;
        if (rows.begin >= rows.end) continue;
        if (rows.known(96))
            for (int y = rows.first_row(); y < rows.last_row(); ++y) {
                const Span x = cover.columns(y, rows);
                rows.columns[std::size_t(y - rows.first_row())] = {
                    static_cast<std::uint16_t>(x.begin), static_cast<std::uint16_t>(x.end)};
            }
        m.footprint.push_back(f);
        m.rows.push_back(rows);
        m.key.push_back(static_cast<std::uint32_t>(random.bits(8 * i + 5) % 1000));
    }
    for (Index k = 0; k < m.count(); ++k)
        m.index.push_back(static_cast<std::uint32_t>((k * 7) % m.count()));
    return m;
}

} // namespace

TEST_CASE("tile lists: the sort is stable and sorts, in 32 bits and in 64") {
    check_sort<std::uint32_t>();
    check_sort<std::uint64_t>();
}

TEST_CASE("tile lists: each is near to far, ties by index, and members find their entries") {
    const Members members = random_members();
    const TileLists lists = members.lists(Serial{});
    bool sorted = true, found = true, mentioned = true;
    for (std::size_t t = 0; t < std::size_t(lists.tiles()); ++t)
        for (Index k = lists.begin[t]; k < lists.begin[t + 1]; ++k) {
            const std::size_t m = lists.entry[std::size_t(k)].member;
            const Cover<Support::ellipse, float> cover{members.footprint[m], 96, 96};
            const int row = int(t) / lists.columns, column = int(t) % lists.columns;
            const Span x = cover.columns(row, members.rows[m]);
            mentioned &= column >= x.begin && column < x.end;
            if (k == lists.begin[t]) continue;
            const std::size_t before = lists.entry[std::size_t(k) - 1].member;
            sorted &= std::pair(members.key[before], members.index[before]) <
                      std::pair(members.key[m], members.index[m]);
        }
    // Each slot is one entry's, and one of those of the entry's member, tile after tile.
    std::vector<Index> entry_of(std::size_t(lists.entries()), -1);
    for (Index k = 0; k < lists.entries(); ++k) {
        const std::size_t m = lists.entry[std::size_t(k)].member;
        const std::size_t slot = lists.entry[std::size_t(k)].slot;
        found &= Index(slot) >= lists.first[m] && Index(slot) < lists.first[m + 1];
        found &= entry_of[slot] == -1;
        entry_of[slot] = k;
    }
    Index expected = 0;
    for (std::size_t m = 0; m < std::size_t(members.count()); ++m) {
        for (Index i = lists.first[m] + 1; i < lists.first[m + 1]; ++i)
            found &= entry_of[std::size_t(i) - 1] < entry_of[std::size_t(i)];
        const Cover<Support::ellipse, float> cover{members.footprint[m], 96, 96};
        for (int y = members.rows[m].first_row(); y < members.rows[m].last_row(); ++y) {
            const Span x = cover.columns(y, members.rows[m]);
            expected += x.end - x.begin;
        }
    }
    CHECK(sorted);
    CHECK(found);
    CHECK(mentioned);
    CHECK(lists.entries() == expected);
    CHECK(lists.first.back() == expected);
}

TEST_CASE("tile lists: threads change nothing") {
    const Members members = random_members();
    REQUIRE(members.count() > 4096);
    const TileLists one = members.lists(Serial{}), many = members.lists(DefaultThreads{});
    CHECK(one.begin == many.begin);
    CHECK(one.entry == many.entry);
    CHECK(one.first == many.first);
}

namespace {

/// The lists of n equal Gaussians that cover all of a square image, one behind the other.
TileLists lists_of_covering(int side, Index n, std::uint64_t max_memory,
                            detail::BinScratch<std::uint32_t>& scratch) {
    const float s = 1e6F, middle = 0.5F * static_cast<float>(side);
    const Footprint<float> f{middle, middle, 3, {s * s, 0, s * s}, s * s * s * s};
    detail::TileRows rows{};
    const Cover<Support::ellipse, float> cover{f, side, side};
    rows.begin = cover.rows().begin, rows.end = cover.rows().end;
    TileLists out;
    out.build<Support::ellipse, float>(
        Serial{}, {side, side},
        detail::BinInput{n, [&](Index) -> const detail::TileRows& { return rows; },
                         [](Index m) { return static_cast<std::uint32_t>(m); },
                         [](Index m) { return static_cast<std::uint32_t>(m); },
                         [&](Index) -> const Footprint<float>& { return f; }},
        max_memory, scratch);
    return out;
}

} // namespace

TEST_CASE("tile lists: too many entries are refused before there is memory for them") {
    detail::BinScratch<std::uint32_t> scratch;
    CHECK_THROWS_AS(lists_of_covering(16384, 5000, std::uint64_t(1) << 36U, scratch), Error);
    std::size_t held = scratch.binned.capacity();
    for (const auto& chunk : scratch.chunks) held += chunk.mentions.capacity();
    CHECK(held < std::size_t(2 * TileLists::most_unchecked) * scratch.chunks.size());
}

TEST_CASE("tile lists: 5000 Gaussians that cover a picture of 2048 x 2048 are refused by default") {
    detail::BinScratch<std::uint32_t> scratch;
    const std::uint64_t limit = Balanced{}.max_memory;
    std::string message;
    try {
        lists_of_covering(2048, 5000, limit, scratch);
    } catch (const Error& e) {
        message = e.what();
    }
    CHECK(message == "rasterizer: got 81920000 pairs of a tile and a Gaussian, whose lists would take " +
                         std::to_string(81920000 * TileLists::entry_bytes<>) +
                         " bytes of memory, expected at most the limit of 2147483648: the Gaussians "
                         "are too large for the image");
    std::uint64_t held = scratch.binned.capacity();
    for (const auto& chunk : scratch.chunks) held += chunk.mentions.capacity();
    CHECK(held * sizeof(scratch.binned[0]) < limit / 4);
    CHECK(lists_of_covering(512, 100, 102400 * TileLists::entry_bytes<>, scratch).entries() == 102400);
    CHECK_THROWS_AS(lists_of_covering(512, 100, 102400 * TileLists::entry_bytes<> - 1, scratch), Error);
}

TEST_CASE("tile lists: what an entry is said to take is what it takes") {
    detail::BinScratch<std::uint32_t> scratch;
    const TileLists lists = lists_of_covering(1024, 6000, default_memory, scratch);
    std::uint64_t held = scratch.binned.capacity() * sizeof(scratch.binned[0]) +
                         lists.entry.capacity() * sizeof(lists.entry[0]);
    for (const auto& chunk : scratch.chunks)
        held += chunk.mentions.capacity() * sizeof(chunk.mentions[0]);
    for (const auto& buffer : scratch.buffers) held += buffer.capacity() * sizeof(buffer[0]);
    const auto stated =
        static_cast<std::uint64_t>(lists.entries()) * TileLists::entry_bytes<>;
    CHECK(held <= stated);
    CHECK(held > stated / 2);
}

TEST_CASE("tile lists: more entries than are written unchecked are all there") {
    detail::BinScratch<std::uint32_t> scratch;
    const Index tiles = 256 * 256, n = TileLists::most_unchecked / tiles + 2;
    const TileLists lists = lists_of_covering(4096, n, default_memory, scratch);
    CHECK(lists.entries() == n * tiles);
    bool each = true;
    for (Index t = 0; t < tiles; ++t)
        for (Index k = 0; k < n; ++k) {
            const Intersection& e = lists.entry[std::size_t(lists.begin[std::size_t(t)] + k)];
            each &= e.member == std::uint32_t(k) && e.slot == std::uint32_t(k * tiles + t);
        }
    CHECK(each);
}
