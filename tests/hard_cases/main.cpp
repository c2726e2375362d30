// SPDX-License-Identifier: Apache-2.0
// hard_cases [--page FILE] [--flush-to-zero] [--textbook]: runs every hard case; exit status 1 if
// one fails. --page also writes docs/results/hard_cases.md; --flush-to-zero flushes denormals in
// every thread; --textbook lists the entries for which the textbook's formula fails the law that
// rye's satisfies.
#include <cstdio>
#include <cstring>
#include <fstream>
#include <map>
#include <set>

#include "report.hpp"

using namespace rye::hard;

namespace {

std::string number(double x) {
    if (std::isnan(x)) return "NaN";
    if (std::isinf(x)) return "inf";
    char text[32];
    std::snprintf(text, sizeof text, x == 0 ? "0" : "%.1e", x);
    return text;
}

struct Counts {
    std::size_t tested = 0, elsewhere = 0, absent = 0, textbook = 0;
};

Counts count(const Report& report) {
    std::set<std::string> tested, textbook;
    for (const Row& r : report.rows) (r.textbook ? textbook : tested).insert(r.id);
    Counts c{tested.size(), 0, 0, textbook.size()};
    for (const Entry& e : catalogue())
        if (tested.count(std::string(e.id)) == 0)
            ++(e.elsewhere.starts_with("absent") ? c.absent : c.elsewhere);
    return c;
}

/// Rows of one law and one requirement: kinds of number, and the worst of them (textbook: the best).
struct Group {
    const Row* row;
    std::string kinds;
    double reached;
};

std::vector<Group> groups(const std::vector<const Row*>& rows) {
    std::vector<Group> all;
    for (const Row* r : rows) {
        auto g = std::find_if(all.begin(), all.end(), [&](const Group& x) {
            return x.row->inputs == r->inputs && x.row->demanded == r->demanded &&
                   x.row->textbook == r->textbook;
        });
        if (g == all.end()) {
            all.push_back({r, r->kind, r->reached});
            continue;
        }
        g->kinds += "; " + r->kind;
        if (r->textbook)
            g->reached = std::min(g->reached, r->reached);
        else
            worsen(g->reached, r->reached);
    }
    return all;
}

/// Escapes bars, which would end the cell of a table.
std::string in_cell(const std::string& text) {
    std::string out;
    for (const char c : text) (c == '|' ? out += '\\' : out) += c;
    return out;
}

void write_page(const Report& report, const char* path) {
    const Counts c = count(report);
    std::ofstream out(path);
    out << "# Hard cases\n\n"
           "```\nhard_cases --page docs/results/hard_cases.md\n```\n\n"
           "Commit and machine: not recorded.\n\n"
           "An entry is an input for which the textbook's formula fails, in float or in general, "
           "with the accuracy required of\n"
           "rye's formula and the worst that it reached. A row in *italics* is the textbook's "
           "formula, or a common alternative,\n"
           "under the same requirement: it must fail, which shows that the requirement is "
           "meaningful. \"holds\" is a fact without a\nnumber.\n\n"
        << catalogue().size() << " entries: " << c.tested << " tested here, " << c.elsewhere
        << " by another test, " << c.absent << " about code that does not exist; for "
        << c.textbook
        << " the textbook's formula is shown to fail\n(`hard_cases --textbook` lists them).\n\n"
           "These and the other numerical tests also run with denormals flushed to zero: each such "
           "program\ntakes `--flush-to-zero`, and ctest runs it both ways. `sh tests/variants.sh` "
           "builds and runs\nthem with fused products and without, under the address and "
           "undefined-behaviour sanitizers, and\nwith clang; that takes many minutes.\n\n"
        << "| entry | inputs or formula | number | required | reached |\n|---|---|---|---|---|\n";
    std::map<std::string, std::vector<const Row*>> by_id;
    for (const Row& r : report.rows) by_id[r.id].push_back(&r);
    for (const Entry& e : catalogue()) {
        const auto found = by_id.find(std::string(e.id));
        out << "| **" << e.id << "** " << e.title << " | ";
        if (found == by_id.end()) {
            out << e.elsewhere << " | | | |\n";
            continue;
        }
        out << e.elsewhere << " | | | |\n";
        for (const Group& g : groups(found->second)) {
            const char* star = g.row->textbook ? "*" : "";
            const bool fact = g.row->demanded < 0;
            out << "| | " << star << in_cell(g.row->inputs) << star << " | " << g.kinds << " | "
                << (fact ? "holds" : number(g.row->demanded)) << " | "
                << (!fact            ? number(g.reached)
                    : g.reached == 0 ? "holds"
                                     : "does not hold")
                << " |\n";
        }
    }
}

/// Lists each entry with its failing textbook rows, the formula and its smallest error.
void list_textbook(const Report& report) {
    for (const Entry& e : catalogue()) {
        std::vector<const Row*> rows;
        for (const Row& r : report.rows)
            if (r.textbook && r.id == e.id && r.passed()) rows.push_back(&r);
        for (const Group& g : groups(rows)) {
            const bool fact = g.row->demanded < 0;
            std::printf("%-4s %s: demanded %s, reached %s\n", g.row->id.c_str(),
                        g.row->inputs.c_str(),
                        fact ? "that it holds" : number(g.row->demanded).c_str(),
                        fact ? "it does not" : number(g.reached).c_str());
        }
    }
}

} // namespace

int main(int argc, char** argv) {
    const char* page = nullptr;
    bool list = false;
    rye::flush_to_zero_if_asked(argc, argv);
    for (int i = 1; i < argc; ++i) {
        if (std::strcmp(argv[i], "--page") == 0 && i + 1 < argc) page = argv[++i];
        if (std::strcmp(argv[i], "--textbook") == 0) list = true;
    }
    Report report;
    determinants(report);
    cameras(report);
    blending(report);
    images(report);
    tiling(report);
    rotations(report);
    rigs(report);
    colours(report);
    networks(report);
    losses(report);
    surfaces(report);
    duals(report);
    machines(report);
    files(report);

    int failed = 0;
    std::set<std::string> known, seen;
    for (const Entry& e : catalogue()) known.insert(std::string(e.id));
    for (const Row& r : report.rows) {
        if (!r.textbook) seen.insert(r.id);
        const bool strange = known.count(r.id) == 0;
        if (r.passed() && !strange) continue;
        ++failed;
        std::printf("%s %s, %s: %s: demanded %s, reached %s%s\n", strange ? "unknown" : "failed",
                    r.id.c_str(), r.kind.c_str(), r.inputs.c_str(), number(r.demanded).c_str(),
                    number(r.reached).c_str(), r.textbook ? " (a textbook formula must fail)" : "");
    }
    for (const Entry& e : catalogue())
        if (e.elsewhere.empty() && seen.count(std::string(e.id)) == 0) {
            ++failed;
            std::printf("failed %s: no test and no word why\n", std::string(e.id).c_str());
        }
    if (list) list_textbook(report);
    const Counts c = count(report);
    if (catalogue().size() != 128 || c.textbook < 40) ++failed;
    std::printf(
        "%zu entries, %zu tested here with %zu laws, %zu elsewhere, %zu absent; textbook "
        "formulas fail for %zu; %d faults\n",
        catalogue().size(), c.tested, report.rows.size(), c.elsewhere, c.absent, c.textbook,
        failed);
    if (page != nullptr) write_page(report, page);
    return failed == 0 ? 0 : 1;
}
