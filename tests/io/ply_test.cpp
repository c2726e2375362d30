// SPDX-License-Identifier: Apache-2.0
// The standard Gaussian PLY: written clouds are read back, properties that other writers omit or
// add are accepted, and malformed files are rejected by name before any large allocation.
// RYE_DATA may name a folder with splats/biker.ply; without it the last case passes untested.
#include <rye/io/ply.hpp>

#include <chrono>
#include <csignal>
#include <filesystem>
#include <limits>
#include <sstream>
#include <thread>
#include <utility>

#include <sys/stat.h>

#include <doctest/doctest.h>

#include <rye/core/random.hpp>

#include "../support/real_data.hpp"

using namespace rye;

namespace {

GaussianCloud<float> cloud_of(Index n, int degree) {
    GaussianCloud<float> c(n, degree);
    std::uint64_t k = 0;
    GaussianCloud<float>::fields(
        [&](const std::string&, Columns<float>& a) {
            for (Index i = 0; i < a.size(); ++i)
                a.data()[i] = static_cast<float>(Random{1, 2}.normal(k++));
        },
        c);
    return c;
}

bool same(const GaussianCloud<float>& a, const GaussianCloud<float>& b) {
    bool equal = true;
    GaussianCloud<float>::fields(
        [&](const std::string&, const Columns<float>& x, const Columns<float>& y) {
            equal = equal && x.rows() == y.rows() && x.cols() == y.cols() && x == y;
        },
        a, b);
    return equal;
}

std::string written(const GaussianCloud<float>& c, const PlyOptions& o = {}) {
    std::ostringstream out;
    write_ply(out, c, o);
    return out.str();
}

GaussianCloud<float> parsed(const std::string& text) {
    std::istringstream in(text);
    return read_ply<float>(in, "some.ply");
}

const std::string numbers = "property float x\nproperty float y\nproperty float z\n"
                            "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n"
                            "property float opacity\nproperty float scale_0\n"
                            "property float scale_1\nproperty float rot_0\nproperty float rot_1\n"
                            "property float rot_2\nproperty float rot_3\n";

/// The message of the Error of reading a text.
std::string fault(const std::string& text) {
    try {
        parsed(text);
    } catch (const Error& e) {
        return e.what();
    }
    return "";
}

bool mentions(const std::string& text, const std::string& word) {
    return text.find(word) != std::string::npos && text.find("some.ply") != std::string::npos;
}

} // namespace

TEST_CASE("ply: what is written is read back bit for bit, at every degree") {
    for (int degree = 0; degree <= 4; ++degree) {
        const auto c = cloud_of(7, degree);
        CHECK(same(parsed(written(c)), c));
    }
    CHECK(parsed(written(cloud_of(0, 1))).count() == 0);
}

TEST_CASE("ply: a record is 68 bytes at degree 0 and 248 at degree 3") {
    const std::string header = "end_header\n";
    const auto body = [&](const std::string& s) { return s.size() - s.find(header) - 11; };
    CHECK(body(written(cloud_of(2, 0))) == 2 * 68);
    CHECK(body(written(cloud_of(2, 3))) == 2 * 248);
    CHECK(body(written(cloud_of(2, 0), {.degree = 3})) == 2 * 248);
}

TEST_CASE("ply: padding keeps each channel's coefficients and adds zeros behind them") {
    const auto c = cloud_of(3, 1);
    const auto p = parsed(written(c, {.degree = 2, .comment = "padded"}));
    REQUIRE(p.degree() == 2);
    for (int channel = 0; channel < 3; ++channel) {
        CHECK(p.sh_rest.middleRows(8 * channel, 3) == c.sh_rest.middleRows(3 * channel, 3));
        CHECK(p.sh_rest.middleRows(8 * channel + 3, 5).cwiseAbs().maxCoeff() == 0);
    }
    CHECK_THROWS_AS(written(c, {.degree = 0}), Error);
}

TEST_CASE("ply: ascii, CRLF, another order, extra and missing properties") {
    const std::string text = "ply\r\nformat ascii 1.0\r\ncomment hello\r\nelement vertex 2\r\n"
                             "property uchar red\r\n" + numbers +
                             "element face 1\r\nproperty list uchar int vertex_indices\r\n"
                             "end_header\r\n"
                             "9 1 2 3 .1 .2 .3 -1 -2 -3 1 0 0 0\r\n"
                             "9 4 5 6 .4 .5 .6 +1e-1 -5 -6 0 1 0 0\r\n3 0 0 0\r\n";
    const auto c = parsed(text);
    REQUIRE(c.count() == 2);
    CHECK(c.degree() == 0);
    CHECK(c.mean(1, 1) == 5.0F);
    CHECK(c.logit_opacity(0, 1) == 0.1F);
    CHECK(c.log_scale(1, 0) == -3.0F);
    CHECK(c.log_scale(2, 0) == -20.0F);
    CHECK(c.rotation(1, 1) == 1.0F);
}

TEST_CASE("ply: doubles and an element before the vertices") {
    std::string text = "ply\nformat binary_little_endian 1.0\nelement camera 1\n"
                       "property double f\nelement vertex 1\n" + numbers + "end_header\n";
    for (auto at = text.find("float"); at != std::string::npos; at = text.find("float"))
        text.replace(at, 5, "double");
    double values[14] = {99, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13};
    text.append(reinterpret_cast<const char*>(values), sizeof values);
    const auto c = parsed(text);
    CHECK(c.mean(0, 0) == 1.0F);
    CHECK(c.rotation(3, 0) == 13.0F);
}

TEST_CASE("ply: files that lie are refused, with the file and the fault in the message") {
    const std::string begin = "ply\nformat binary_little_endian 1.0\nelement vertex ";
    const auto of_count = [&](const std::string& n) {
        return begin + n + "\n" + numbers + "end_header\nabcd";
    };
    CHECK(mentions(fault(of_count("1152921504606846976")), "vertices"));
    CHECK(mentions(fault(of_count("1")), "vertices"));
    CHECK(mentions(fault(of_count("-1")), "-1"));
    CHECK(mentions(fault(of_count("1e99")), "1e99"));
    CHECK(mentions(fault(of_count("99999999999999999999")), "99999999999999999999"));
    CHECK(mentions(fault("ply\nformat binary_big_endian 1.0\n"), "big-endian"));
    CHECK(mentions(fault("ply\nformat ascii 1.0\nelement vertex 1\n"), "end_header"));
    CHECK(mentions(fault("plx\n"), "ply"));
    CHECK(mentions(fault(begin + "1\nproperty float x\nproperty float x\nend_header\n"), "twice"));
    CHECK(mentions(fault(begin + "1\nproperty list uchar float x\nend_header\n"), "list"));
    CHECK(mentions(fault(begin + "1\nproperty quad x\nend_header\n"), "quad"));
    CHECK(mentions(fault(begin + "0\nproperty float x\nend_header\n"), "f_dc_0"));
    CHECK(mentions(fault(begin + "0\n" + numbers + "property float f_rest_0\nend_header\n"),
                   "f_rest"));
    CHECK(mentions(fault("ply\nformat ascii 1.0\nelement vertex 1\n" + numbers +
                         "end_header\n1 2 3 4 5 6 7 8 x 1 0 0 0\n"),
                   "scale_1"));
    CHECK(mentions(fault("ply\nformat ascii 1.0\nelement vertex 2\n" + numbers +
                         "end_header\n1 2 3 4 5 6 7 8 9 1 0 0 0 0000000000000000000000000000\n"),
                   "whole vertices"));
    CHECK(mentions(fault(std::string(5000, 'a')), "header line"));
}

TEST_CASE("ply: discs without a vertex are a cloud without Gaussians") {
    const std::string text = "ply\nformat ascii 1.0\nelement vertex 0\n" + numbers + "end_header\n";
    REQUIRE(text.find("scale_2") == std::string::npos);
    CHECK(parsed(text).count() == 0);
}

TEST_CASE("ply: elements before the vertices that the file does not hold are refused at once") {
    for (const char* format : {"ascii", "binary_little_endian"}) {
        const std::string begin = std::string("ply\nformat ") + format + " 1.0\n";
        const std::string end = "element vertex 0\n" + numbers + "end_header\n";
        CHECK(mentions(fault(begin + "element foo 549755813888\nproperty int i\n" + end),
                       "too few"));
        std::string many;
        for (int i = 0; i < 20; ++i)
            many += "element foo" + std::to_string(i) +
                    " 1099511627775\nproperty double d\nproperty double e\n";
        CHECK(mentions(fault(begin + many + end), "too few"));
        for (int i = 0; i < 3; ++i)
            many += "element bar 9223372036854775807\nproperty double d\n";
        CHECK(mentions(fault(begin + many + end), "too large to skip"));
    }
}

TEST_CASE("ply: a header of 65,000 properties is read in a moment") {
    std::string text = "ply\nformat binary_little_endian 1.0\nelement vertex 0\n" + numbers;
    for (int i = 0; i < 65000; ++i) text += "property char p" + std::to_string(i) + "\n";
    const auto begin = std::chrono::steady_clock::now();
    CHECK(parsed(text + "end_header\n").count() == 0);
    CHECK(std::chrono::steady_clock::now() - begin < std::chrono::seconds(2));
}

TEST_CASE("ply: a number that is not finite is refused with its property and its vertex") {
    const std::string begin = "ply\nformat ascii 1.0\nelement vertex 2\n" + numbers +
                              "end_header\n0 0 0 0 0 0 0 0 0 1 0 0 0\n0 0 0 0 0 0 ";
    CHECK(mentions(fault(begin + "nan 0 0 1 0 0 0\n"), "opacity of vertex 1"));
    for (const char* bad : {"nan", "inf", "-inf", "1e300"})
        CHECK(mentions(fault(begin + "0 0 " + bad + " 1 0 0 0\n"), "scale_1 of vertex 1"));
    auto c = cloud_of(2, 0);
    c.mean(1, 1) = std::numeric_limits<float>::quiet_NaN();
    CHECK(mentions(fault(written(c)), "property y of vertex 1"));
}

TEST_CASE("ply: an infinite logit is an opacity of almost 1 or 0") {
    const std::string begin = "ply\nformat ascii 1.0\nelement vertex 1\n" + numbers +
                              "end_header\n0 0 0 0 0 0 ";
    const float opaque = parsed(begin + "inf 0 0 1 0 0 0\n").logit_opacity(0, 0);
    const float invisible = parsed(begin + "-inf 0 0 1 0 0 0\n").logit_opacity(0, 0);
    CHECK(std::isfinite(opaque));
    CHECK(sigmoid(opaque) >= 1 - std::numeric_limits<float>::epsilon());
    CHECK(std::isfinite(invisible));
    CHECK(sigmoid(invisible) <= std::numeric_limits<float>::epsilon());
}

TEST_CASE("ply: read through a pipe, which cannot tell its length") {
    std::string ascii = "ply\nformat ascii 1.0\nelement vertex 1\n" + numbers +
                        "end_header\n1 2 3 4 5 6 7 8 9 1 0 0 0\n";
    const auto c = cloud_of(5000, 1);
    const auto through = [](const std::string& text) {
        std::string name = (std::filesystem::temp_directory_path() / "rye-ply-XXXXXX").string();
        REQUIRE(::mkdtemp(name.data()) != nullptr);
        const std::string pipe = name + "/some.ply";
        REQUIRE(::mkfifo(pipe.c_str(), 0600) == 0);
        std::thread writer([&] {
            std::signal(SIGPIPE, SIG_IGN);
            std::ofstream(pipe, std::ios::binary) << text;
        });
        GaussianCloud<float> read;
        std::string told;
        try {
            read = read_ply<float>(pipe);
        } catch (const Error& e) {
            told = e.what();
        }
        writer.join();
        std::filesystem::remove_all(name);
        return std::pair{read, told};
    };
    CHECK(same(through(written(c)).first, c));
    CHECK(through(ascii).first.mean(2, 0) == 3.0F);
    CHECK(through(written(c).substr(0, 100000)).second.find("too few") != std::string::npos);
    // A count that would need all memory, in a pipe that ends.
    CHECK(through("ply\nformat binary_little_endian 1.0\nelement vertex 1152921504606846976\n" +
                  numbers + "end_header\nabcd")
              .second.find("too few") != std::string::npos);
    CHECK_THROWS_AS(read_ply<float>("/"), Error);
}

TEST_CASE("ply: a real trained scene and a file of degree 3") {
    const auto scene = test::real_data("splats/biker.ply");
    const auto points = test::real_data("splats/test-splat.3-points-from-train.ply");
    if (!scene || !points) return;
    const auto biker = read_ply<float>(scene->string());
    CHECK(biker.count() == 152746);
    CHECK(biker.degree() == 0);
    CHECK(biker.mean.allFinite());
    const auto three = read_ply<float>(points->string());
    CHECK(three.count() == 3);
    CHECK(three.degree() == 3);
    CHECK(same(parsed(written(three)), three));
}

TEST_CASE("ply: a flipped bit is refused, or changes nothing that is read") {
    const auto c = cloud_of(2, 0);
    const std::string whole = written(c, {.comment = "a"});
    int told = 0;
    for (std::size_t bit = 0; bit < 8 * whole.size(); ++bit) {
        std::string damaged = whole;
        char& byte = damaged[bit / 8];
        byte = static_cast<char>(static_cast<unsigned char>(byte) ^ (1U << (bit % 8)));
        try {
            const auto read = parsed(damaged);
            INFO(bit);
            CHECK(same(read, c));
        } catch (const Error&) {
            ++told;
        }
    }
    // Of the numbers' bits each is told.
    CHECK(told >= 8 * 2 * 68);
    std::string other = whole;
    other.back() = static_cast<char>(other.back() ^ 1);
    CHECK_THROWS_WITH_AS(parsed(other), doctest::Contains("the file is damaged"), Error);
    const std::size_t line = other.find("comment checksum");
    other.erase(line, other.find('\n', line) + 1 - line);
    CHECK(parsed(other).count() == 2);
}
