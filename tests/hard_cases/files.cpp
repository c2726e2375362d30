// SPDX-License-Identifier: Apache-2.0
// Malformed files, and full disks (J1, J2, J4, J5, J7, J11, J12).
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <rye/io/atomic_file.hpp>
#include <rye/io/json.hpp>
#include <rye/io/npz.hpp>
#include <rye/io/safetensors.hpp>
#include <rye/io/ply.hpp>

#include "report.hpp"

namespace rye::hard {
namespace {

/// f throws an Error with one line, within 64 MiB more than is used now.
template <class F>
bool refused(F&& f) {
    struct rusage before {
    }, after{};
    ::getrusage(RUSAGE_SELF, &before);
    bool told = false;
    try {
        f();
    } catch (const Error& e) {
        told = std::string(e.what()).find('\n') == std::string::npos;
    }
    ::getrusage(RUSAGE_SELF, &after);
    return told && after.ru_maxrss - before.ru_maxrss < 65536;
}

void j1(Report& report) {
    std::string numbers;
    for (const char* n : {"x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0",
                          "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
        numbers += std::string("property float ") + n + "\n";
    const auto read = [](const std::string& text) {
        return refused([&] {
            std::istringstream in(text);
            read_ply<float>(in, "some.ply");
        });
    };
    const std::string begin = "ply\nformat binary_little_endian 1.0\nelement vertex ";
    bool all = true;
    for (const char* n : {"1152921504606846976", "-1", "1e99", "4294967295", "20", "x", ""})
        all = all && read(begin + n + "\n" + numbers + "end_header\nabcd");
    all = all && read("ply\nformat binary_big_endian 1.0\n");
    all = all && read("ply\nformat ascii 1.0\nelement vertex 1\n" + numbers); // no end
    all = all && read("ply\nformat ascii 1.0\nelement vertex 1\n" + numbers + numbers +
                      "end_header\n"); // duplicates
    all = all && read("ply\nformat ascii 1.0\nelement vertex 1\n" + numbers + "end_header\n1 x\n");
    all = all && read("ply\nformat ascii 1.0\nelement vertex 1\n" + numbers +
                      "end_header\n1 2 3 4 5 6 7 8 9 nan 0 0 0 0\n");
    report.holds("J1", "ply",
                 "counts 2^60, -1, 1e99, 2^32-1, 20 of none; big-endian; cut; twice; NaN", all);
    all = true;
    for (const char* format : {"ascii", "binary_little_endian"})
        for (const char* n : {"549755813888", "9223372036854775807"})
            all = all && read(std::string("ply\nformat ") + format + " 1.0\nelement foo " + n +
                              "\nproperty int i\nelement vertex 0\n" + numbers + "end_header\n");
    report.holds("J1", "ply", "2^39 and 2^63 - 1 of another element before the vertices", all);
    const std::uint64_t count = 1152921504606846976ULL;
    report.textbook_fails("J1", "ply", "count * 16 in 64 bits is larger than count",
                          count * 16 > count);
}

void j2(Report& report) {
    const auto npy = [](std::string_view text) {
        return refused([&] { parse_npy(as_bytes(text), "a.npy"); });
    };
    bool all = npy(std::string_view("\x93NUMPY\x02\x00\xF0\xFF\xFF\xFF", 12)) && npy("") &&
               npy("\x93NUMPY");
    for (const char* shape : {"(4294967296, 4294967296)", "(4611686018427387904, 2, 0)"}) {
        const std::string header =
            std::string("{'descr': '|u1', 'fortran_order': False, 'shape': ") + shape + ", }";
        std::string file("\x93NUMPY\x01\x00", 8);
        file += static_cast<char>(header.size());
        file += '\0';
        all = all && npy(file + header);
    }
    Bytes zip(22, std::byte{0xFF});
    all = all && refused([&] { parse_npz(zip, "a.npz"); });
    // A stream that states a result a thousand times larger than deflate can give.
    const Bytes small(16, std::byte{0});
    all = all && refused([&] { inflate(small, 1ULL << 40U, "bomb"); });
    report.holds("J2", "npy, npz",
                 "header of 2^32 - 16; shapes (2^32, 2^32), (2^62, 2, 0); bomb; empty", all);
    // Two names of a zip's directory for one member.
    const std::vector<float> number{1};
    Bytes twice = npz_bytes({{"a", npy_array<float>({1}, number)}});
    const std::size_t entry = 46 + 5, directory = twice.size() - 22 - entry;
    const Bytes again(twice.begin() + static_cast<std::ptrdiff_t>(directory),
                      twice.begin() + static_cast<std::ptrdiff_t>(directory + entry));
    twice.insert(twice.begin() + static_cast<std::ptrdiff_t>(directory), again.begin(), again.end());
    twice[directory + 46] = std::byte('b');
    const std::size_t end = twice.size() - 22;
    twice[end + 8] = twice[end + 10] = std::byte(2);
    report.holds("J2", "npz", "two members of one file on the same bytes", refused([&] {
                     parse_npz(twice, "a.npz");
                 }));
    const std::uint64_t extent = 4294967296ULL;
    report.textbook_fails("J2", "npy", "2^32 * 2^32 in 64 bits is not 0", extent * extent != 0);
}

void j4_j5(Report& report) {
    bool all = true;
    const auto json = [](const std::string& text) {
        return refused([&] { parse_json(text, "a.json"); });
    };
    for (const char* t : {"NaN", "Infinity", "1e999", "{\"a\":1,\"a\":2}", "\"\\ud800\"", "[1,]"})
        all = all && json(t);
    all = all && json(std::string(1000000, '[')) && json("\xEF\xBB\xBF{");
    report.holds("J4", "json", "depth 1e6, NaN, 1e999, duplicate key, lone surrogate, BOM", all);
    all = true;
    const auto tensors = [](std::uint64_t length, const std::string& header) {
        std::string file(8, '\0');
        std::memcpy(file.data(), &length, 8);
        file += header;
        return refused([&] { parse_safetensors(as_bytes(file), "a.safetensors"); });
    };
    all = all && tensors(1ULL << 63U, "{}") && tensors(100, "{}") && tensors(1, "[");
    for (const char* h :
         {R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})",
          R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[8,0]}})",
          R"({"a":{"dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,0]}})",
          R"({"a":{"dtype":"F99","shape":[0],"data_offsets":[0,0]}})"})
        all = all && tensors(std::string_view(h).size(), h);
    report.holds("J5", "safetensors", "header 2^63, cut; offsets past the end, reversed; overflow",
                 all);
}

void j7_j11_j12(Report& report) {
    namespace fs = std::filesystem;
    std::string name = (fs::temp_directory_path() / "rye-hard-XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) return;
    const fs::path folder = fs::path(name) / "with space \xC3\xA9";
    fs::create_directory(folder);
    const fs::path path = folder / "state";
    write_atomic(path, as_bytes("old"), Durability::atomic_only);
    // A limit on the file's size simulates a full disk.
    struct rlimit kept {};
    ::getrlimit(RLIMIT_FSIZE, &kept);
    struct rlimit little = kept;
    little.rlim_cur = 4096;
    void (*before)(int) = ::signal(SIGXFSZ, SIG_IGN);
    ::setrlimit(RLIMIT_FSIZE, &little);
    const std::string big(100000, 'x');
    const bool told = refused([&] { write_atomic(path, as_bytes(big), Durability::atomic_only); });
    std::ofstream plain(folder / "plain", std::ios::binary);
    plain << "old";
    plain.close();
    plain.open(folder / "plain", std::ios::binary); // truncates before it writes
    plain << big;
    plain.close();
    ::setrlimit(RLIMIT_FSIZE, &kept);
    ::signal(SIGXFSZ, before);
    const auto content = [](const fs::path& p) {
        std::ifstream in(p, std::ios::binary);
        std::ostringstream all;
        all << in.rdbuf();
        return all.str();
    };
    std::size_t left = 0;
    for (const auto& e : fs::directory_iterator(folder)) left += e.exists() ? 1 : 0;
    report.holds("J7", "file", "disk full: Error, old file whole, nothing else left",
                 told && content(path) == "old" && left == 2);
    report.textbook_fails("J7", "file", "open for writing, then write: the old file stays",
                          content(folder / "plain") == "old");
    // J11: a name with a space and UTF-8; a link stays one; a folder is rejected.
    const fs::path link = fs::path(name) / "link";
    fs::create_symlink(path, link);
    write_atomic(link, as_bytes("new"), Durability::atomic_only);
    report.holds("J11", "file", "path with space and UTF-8; link kept; a folder refused",
                 content(path) == "new" && fs::is_symlink(link) && refused([&] {
                     write_atomic(folder, as_bytes("x"), Durability::atomic_only);
                 }));
    // J12: another type, another shape, and a missing tensor, each by name.
    const Columns<float> w = Columns<float>::Ones(2, 3);
    write_safetensors(path, {tensor_entry("w", w)}, {});
    const Safetensors file = read_safetensors(path);
    report.holds("J12", "safetensors", "float read as double, another shape, a missing name: Error",
                 refused([&] { file.columns<double>("w"); }) &&
                     refused([&] { file.columns<float>("w", 3, 3); }) &&
                     refused([&] { file.columns<float>("v"); }));
    std::error_code ignored;
    fs::remove_all(name, ignored);
}

} // namespace

void files(Report& report) {
    j1(report);
    j2(report);
    j4_j5(report);
    j7_j11_j12(report);
}

} // namespace rye::hard
