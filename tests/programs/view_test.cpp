// SPDX-License-Identifier: Apache-2.0
// `rye view`: who is answered, what a page is told and drawn, eyes by OSC.
#include <doctest/doctest.h>

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <bit>
#include <cmath>
#include <fstream>
#include <memory>
#include <thread>

#include <rye/io/splats.hpp>
#include <rye/rig/gaze.hpp>

#include "../support/hostile.hpp"
#include "data/degrees.hpp"
#include "data/picture_codecs.hpp"
#include "driving/osc.hpp"
#include "viewing/loopback.hpp"
#include "viewing/view_page.hpp"

using namespace rye;
using namespace rye::trainer;
using Json = nlohmann::json;

namespace {

std::string osc_text(std::string text) {
    text.resize((text.size() / 4 + 1) * 4, '\0');
    return text;
}
std::string big_endian(std::uint32_t x) {
    std::string bytes;
    for (const unsigned shift : {24U, 16U, 8U, 0U}) bytes += static_cast<char>(x >> shift);
    return bytes;
}
std::string osc(const std::string& address, const std::vector<float>& numbers) {
    std::string packet = osc_text(address) + osc_text("," + std::string(numbers.size(), 'f'));
    for (const float x : numbers) packet += big_endian(std::bit_cast<std::uint32_t>(x));
    return packet;
}
/// Gives a packet's messages to a face.
void send(OscFace& face, const std::string& packet, double now) {
    read_osc(as_bytes(packet), "--osc", [&](const OscMessage& m) { face.take(m, now); });
}

/// A scene that remembers what it was asked for.
class Asked : public ViewedScene {
  public:
    Json description() const override { return {{"names", {"smile", "jaw"}}, {"width", 64}}; }
    const std::vector<std::string>& accuracies() const override { return accuracies_; }
    const std::string& usual() const override { return accuracies_.front(); }
    std::vector<std::string> effects() const override { return {"gaze"}; }
    ViewWish first() const override {
        ViewWish w;
        w.drivers.expression = VecX<float>::Zero(2);
        w.drivers.gaze = {gaze_vector(0.0f, 0.0f), gaze_vector(0.0f, 0.0f)};
        w.camera = look_at<float>({0, 0, 4}, {0, 0, 0}, {0, 1, 0}, 0.5f, {64, 32});
        w.accuracy = "coarse";
        return w;
    }
    void add_life(double seconds, Drivers<float>& d) override {
        d.expression[0] = static_cast<float>(seconds);
    }
    void look_to(const Vec3<float>& point, Drivers<float>& d) override {
        const float turn = d.pose[1] + d.expression[1];
        d.gaze[0] = gaze_vector(point[1], point[0] - turn);
        if (point[2] == 0) d.gaze[1].setConstant(std::nanf(""));
    }
    ViewedPicture draw(const ViewWish& w) override {
        require(w.accuracy != "bad", "accuracy", "got bad");
        last = w;
        ViewedPicture p;
        p.picture = Image<float>(w.camera.width, w.camera.height, 3);
        p.picture.pixels.setConstant(w.accuracy == "fine" ? 0.5f : 0.25f);
        p.ms = w.accuracy == "fine" ? 7 : 3;
        p.gaussians = 5;
        return p;
    }
    std::vector<ViewedPrice> prices(const ViewWish& w) override {
        return prices_of(*this, w, accuracies_);
    }
    ViewWish last;

  private:
    std::vector<std::string> accuracies_{"coarse", "fine"};
};

/// Returns the answer of this machine's port to these bytes, until it closes the connection.
std::string talk(int port, const std::string& bytes) {
    const int s = ::socket(AF_INET, SOCK_STREAM, 0);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    std::string answer;
    if (::connect(s, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0) {
        for (std::size_t at = 0; at < bytes.size();) {
            const ::ssize_t n = ::send(s, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
            if (n <= 0) break;
            at += static_cast<std::size_t>(n);
        }
        char part[4096];
        for (::ssize_t n; (n = ::recv(s, part, sizeof part, 0)) > 0;)
            answer.append(part, static_cast<std::size_t>(n));
    }
    ::close(s);
    return answer;
}

} // namespace

TEST_CASE("OSC: VRChat's addresses turn eyes and close them, for ten seconds") {
    OscFace face;
    CHECK_FALSE(face.face(0));
    // 15 degrees up and 20 to the subject's right, as the page of VRChat shows it.
    send(face, osc("/tracking/eye/CenterPitchYaw", {-15, 20}), 1);
    const TrackedFace first = *face.face(1);
    for (const auto& gaze : first.gaze)
        CHECK((*gaze - Vec2<double>(15, -20) * degree).norm() < 1e-6);
    CHECK(first.coefficients.size() == 0);
    send(face, osc("/tracking/eye/LeftRightPitchYaw", {1, 2, 3, 4}), 2);
    CHECK((*face.face(2)->gaze[0] - Vec2<double>(-1, -2) * degree).norm() < 1e-6);
    CHECK((*face.face(2)->gaze[1] - Vec2<double>(-3, -4) * degree).norm() < 1e-6);
    send(face, osc("/tracking/eye/LeftRightVec", {0.5f, 0.5f, 1, -0.5f, 0, 1}), 3);
    CHECK((*face.face(3)->gaze[0] - pitch_yaw(Vec3<double>(-0.5, 0.5, 1))).norm() < 1e-6);
    CHECK((*face.face(3)->gaze[1] - pitch_yaw(Vec3<double>(0.5, 0, 1))).norm() < 1e-6);
    // Half a metre ahead: eyes 64 mm apart turn in by 3.66 degrees each.
    for (const auto& [address, numbers] :
         {std::pair<std::string, std::vector<float>>{"CenterVecFull", {0, 0, 0.5f}},
          {"CenterPitchYawDist", {0, 0, 0.5f}}}) {
        send(face, osc("/tracking/eye/" + address, numbers), 4);
        const double in = std::atan(0.032 / 0.5);
        CHECK((*face.face(4)->gaze[0] - Vec2<double>(0, -in)).norm() < 1e-6);
        CHECK((*face.face(4)->gaze[1] - Vec2<double>(0, in)).norm() < 1e-6);
    }
    send(face, osc("/tracking/eye/CenterVec", {0, 0, 1}), 5);
    CHECK(face.face(5)->gaze[0]->norm() < 1e-9);
    const std::string blink = osc("/tracking/eye/EyesClosedAmount", {0.75f});
    const std::string other = osc("/chatbox/typing", {1});
    send(face,
         osc_text("#bundle") + std::string(8, '\0') +
             big_endian(static_cast<std::uint32_t>(blink.size())) + blink +
             big_endian(static_cast<std::uint32_t>(other.size())) + other,
         10);
    CHECK(face.face(10)->coefficients == VecX<double>::Constant(2, 0.75));
    CHECK(face.face(14.9)->gaze[0].has_value());
    CHECK_FALSE(face.face(15.1)->gaze[0].has_value());
    CHECK_FALSE(face.face(20.1));
}

TEST_CASE("OSC: damaged packets are errors") {
    OscFace face;
    CHECK_FAULT(send(face, "", 0), "an OSC text has no end");
    CHECK_FAULT(send(face, osc_text("tracking"), 0), "got the OSC address 'tracking'");
    CHECK_FAULT(send(face, osc_text("/a") + osc_text("f"), 0), "expected a comma first");
    CHECK_FAULT(send(face, osc_text("/a") + osc_text(",f"), 0), "ends too early");
    CHECK_FAULT(send(face, osc_text("/a") + osc_text(",q"), 0), "got the OSC type 'q'");
    CHECK_FAULT(send(face, osc("/tracking/eye/CenterVec", {1}), 0),
                "/tracking/eye/CenterVec: got 1 numbers, expected 3");
    CHECK_FAULT(send(face, osc("/tracking/eye/EyesClosedAmount", {NAN}), 0), "not finite");
    std::string deep = osc("/a", {});
    for (int i = 0; i < 12; ++i)
        deep = osc_text("#bundle") + std::string(8, '\0') +
               big_endian(static_cast<std::uint32_t>(deep.size())) + deep;
    CHECK_FAULT(send(face, deep, 0), "nested deeper");
    CHECK_FALSE(face.face(0));
}

TEST_CASE("a page is told of the scene, and drawn what it asks for") {
    ViewPage page;
    page.say("mesh, step 20");
    CHECK(Json::parse(page.answer({"GET", "opened", ""}).body).at("waiting") == "mesh, step 20");
    CHECK_FAULT(page.answer({"POST", "draw", "{}"}), "mesh, step 20");
    auto made = std::make_unique<Asked>();
    Asked& scene = *made;
    page.show(std::move(made));
    const Json opened = Json::parse(page.answer({"GET", "opened", ""}).body);
    CHECK(opened.at("accuracy") == "coarse");
    CHECK(opened.at("effects") == Json({"gaze"}));
    CHECK(opened.at("scene") == 1);
    const auto draw = [&](const std::string& body) { return page.answer({"POST", "draw", body}); };
    const WebAnswer drawn = draw(
        R"({"gaze":[0.1,0.2,0.3,0.4],"expression":[1,0.5],"pose":[0,0,0,1,2,3],"width":32,"height":16,)"
        R"("motion":[1,0,0,0, 0,1,0,0, 0,0,1,9, 0,0,0,1],"accuracy":"fine","effects":"gaze"})");
    CHECK(drawn.type == "image/jpeg");
    const Image8 image = decode_jpeg(as_bytes(drawn.body), "drawn");
    CHECK(image.width == 32);
    CHECK(image.height == 16);
    CHECK(std::abs(image.values[0] - 128) <= 2);
    CHECK(Json::parse(drawn.headers.at(0).second).at("ms") == 7);
    CHECK((scene.last.drivers.gaze[1] - gaze_vector(0.3f, 0.4f)).norm() < 1e-6f);
    CHECK(scene.last.drivers.expression[1] == 0.5f);
    CHECK(scene.last.drivers.pose[5] == 3);
    CHECK(scene.last.camera.fx == scene.first().camera.fx / 2);
    CHECK(scene.last.camera.camera_from_world.translation.z() == 9);
    CHECK(scene.last.effects == "gaze");
    // What is not named stays, also after a wish that cannot be drawn.
    CHECK_FAULT(draw(R"({"accuracy":"bad","width":64})"), "accuracy: got bad");
    draw("{}");
    CHECK(scene.last.accuracy == "fine");
    CHECK(scene.last.camera.width == 32);
    CHECK_FAULT(draw("[]"), "draw: got [], expected an object");
    CHECK_FAULT(draw("{"), "draw: not JSON");
    CHECK_FAULT(draw(R"({"gaze":[1,2]})"), "draw: gaze: got 2 numbers, expected 4");
    CHECK_FAULT(draw(R"({"gaze":[1,2,0,0]})"), "draw: gaze: got 2 rad");
    CHECK_FAULT(draw(R"({"pose":[0,0,0,0,0,"x"]})"), "draw: pose: got \"x\"");
    CHECK_FAULT(draw(R"({"width":1e9})"), "draw: width: got 1e+09");
    CHECK_FAULT(draw(R"({"accuracy":3})"), "draw: accuracy: got 3");
    CHECK_FAULT(draw(R"({"idle":3601})"), "draw: idle: got 3601");
    draw(R"({"idle":2.5})"); // in this picture alone
    CHECK(scene.last.drivers.expression[0] == 2.5f);
    draw("{}");
    CHECK(scene.last.drivers.expression[0] == 1);
    // Where eyes look is said, and changes no picture.
    const auto aim = [&](const std::string& body) { return page.answer({"POST", "aim", body}); };
    const Json aimed = Json::parse(
        aim(R"({"point":[0.25,0.1,3],"pose":[0,0.3,0,0,0,0],"expression":[0,0.2]})").body)["aimed"];
    CHECK(std::abs(aimed.at(0).get<float>() - 0.1f) < 1e-6f);
    CHECK(std::abs(aimed.at(1).get<float>() + 0.25f) < 1e-6f);
    CHECK(std::abs(aimed.at(3).get<float>() - 0.4f) < 1e-6f);
    CHECK_FAULT(aim("{}"), "aim: point: got none, expected 3 numbers");
    CHECK_FAULT(aim("[]"), "aim: got [], expected an object");
    CHECK_FAULT(aim(R"({"point":[1,2]})"), "aim: point: got 2 numbers, expected 3");
    CHECK_FAULT(aim(R"({"point":[1,2,0]})"), "aim: point: got the middle of an eye");
    draw("{}");
    CHECK((scene.last.drivers.gaze[0] - gaze_vector(0.1f, 0.2f)).norm() < 1e-6f);
    CHECK(scene.last.drivers.pose[1] == 0);
    const Json prices = Json::parse(page.answer({"POST", "prices", "{}"}).body);
    CHECK(prices.at(0).at("most") == 0.25);
    CHECK(prices.at(1).at("ms") == 7);
    // Something beside the page moves the head while it has something to say.
    bool lives = true;
    page.drive([&](Drivers<float>& d) {
        if (lives) d.expression[0] = -1;
        return lives;
    });
    draw("{}");
    CHECK(scene.last.drivers.expression[0] == -1);
    CHECK(Json::parse(page.answer({"GET", "news", ""}).body).at("live") == true);
    lives = false;
    draw("{}");
    CHECK(scene.last.drivers.expression[0] == 1);
    // A scene of the same head keeps the wish; the page sees its number change.
    page.show(std::make_unique<Asked>());
    CHECK(Json::parse(page.answer({"GET", "news", ""}).body).at("scene") == 2);
    for (const char* file : {"", "page.js", "camera.js", "style.css"})
        CHECK(page.answer({"GET", file, ""}).body.size() > 500);
    CHECK(page.answer({"GET", "page.js", ""}).body.find("ryeRemote = {") != std::string::npos);
    CHECK(page.answer({"GET", "nothing", ""}).status == 404);
    CHECK(page.answer({"GET", "draw", ""}).status == 404);
}

TEST_CASE("splats are seen from before, at every accuracy") {
    GaussianCloud<float> cloud(40, 0);
    for (Index i = 0; i < cloud.count(); ++i) {
        const auto t = static_cast<float>(i);
        cloud.mean.col(i) << 3 + std::cos(t), 4 + std::sin(t), 5;
        cloud.rotation.col(i) << 1, 0, 0, 0;
        cloud.log_scale.col(i).setConstant(-1.5f);
        cloud.logit_opacity(0, i) = 2;
        cloud.sh_constant.col(i) << -1, 0, 1;
    }
    const TemporaryFolder folder;
    const auto file = folder.path / "ring.splat";
    const Bytes bytes = splat_bytes(cloud);
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
    const auto scene = viewed_splats(file);
    CHECK(scene->description().at("still") == true);
    CHECK(scene->description().at("gaussians") == 40);
    ViewWish wish = scene->first();
    wish.camera = scaled(wish.camera, 0.25);
    const auto prices = scene->prices(wish);
    REQUIRE(prices.size() == 4);
    CHECK(prices.back().most == 0);
    for (const ViewedPrice& p : prices) CHECK(p.most < 0.1);
    const Image<float> picture = scene->draw(wish).picture;
    CHECK(picture.pixels.col(0).minCoeff() > 0.9f); // a corner is white, or nearly
    CHECK(picture.pixels.row(0).minCoeff() < 0.6f);
    wish.accuracy = "perfect";
    CHECK_FAULT(scene->draw(wish), "accuracy: got perfect, expected 3dgs, fast, balanced or tight");
}

TEST_CASE("a server answers this machine's page alone") {
    std::atomic<bool> stop = false;
    std::atomic<int> packets = 0;
    std::unique_ptr<LoopbackServer> server;
    try {
        server = std::make_unique<LoopbackServer>(0, [](const WebRequest& r) -> WebAnswer {
            if (r.path == "fault") throw Error("a fault");
            return {200, "text/plain", r.method + " " + r.path + " " + r.body, {{"X-Rye", "1"}}};
        });
    } catch (const Error& e) {
        MESSAGE("skipped: " << e.what());
        return;
    }
    const int port = server->port();
    CHECK_FAULT(LoopbackServer(port, [](const WebRequest&) { return WebAnswer{}; }),
                "--port: got " + std::to_string(port));
    // A free UDP port: that of a socket which is closed again.
    int udp_port = 0;
    const int udp = ::socket(AF_INET, SOCK_DGRAM, 0);
    sockaddr_in here{};
    here.sin_family = AF_INET;
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    {
        const int free = ::socket(AF_INET, SOCK_DGRAM, 0);
        socklen_t size = sizeof here;
        REQUIRE(::bind(free, reinterpret_cast<const sockaddr*>(&here), sizeof here) == 0);
        ::getsockname(free, reinterpret_cast<sockaddr*>(&here), &size);
        udp_port = ntohs(here.sin_port);
        ::close(free);
    }
    server->receive(udp_port, [&](ByteSpan p) { packets += p.size() == 3 ? 1 : 100; });
    std::thread serving([&] { server->run([&] { return stop.load(); }); });
    const std::string address = server->address();
    const std::string secret = address.substr(address.find('/', 8)); // "/SECRET/"
    CHECK(secret.size() == 34);
    const std::string host = "Host: 127.0.0.1:" + std::to_string(port) + "\r\n";
    const auto get = [&](const std::string& path, const std::string& fields) {
        return talk(port, "GET " + path + " HTTP/1.1\r\n" + fields + "Connection: close\r\n\r\n");
    };
    const auto status = [](const std::string& answer) {
        return answer.substr(0, answer.find("\r\n"));
    };
    CHECK(status(get(secret + "x", host)) == "HTTP/1.1 200 OK");
    CHECK(get(secret + "x", host).ends_with("\r\n\r\nGET x "));
    CHECK(get(secret + "x", host).find("X-Rye: 1\r\n") != std::string::npos);
    CHECK(status(get("/x", host)) == "HTTP/1.1 404 Not Found");
    CHECK(status(get(secret + "x", "")) == "HTTP/1.1 403 Forbidden");
    CHECK(status(get(secret + "x", "Host: example.org\r\n")) == "HTTP/1.1 403 Forbidden");
    CHECK(status(get(secret + "x", host + "Origin: http://example.org\r\n")) ==
          "HTTP/1.1 403 Forbidden");
    CHECK(status(get(secret + "x", host + "Origin: http://localhost:" + std::to_string(port) +
                                       "\r\n")) == "HTTP/1.1 200 OK");
    CHECK(get(secret + "fault", host).ends_with("a fault"));
    CHECK(status(get(secret + "fault", host)) == "HTTP/1.1 400 Bad Request");
    CHECK(status(talk(port, "nonsense\r\n\r\n")) == "HTTP/1.1 400 Bad Request");
    CHECK(status(talk(port, "PUT / HTTP/1.1\r\n\r\n")) == "HTTP/1.1 405 Method Not Allowed");
    CHECK(status(talk(port, "POST / HTTP/1.1\r\nContent-Length: 9999999\r\n\r\n")) ==
          "HTTP/1.1 413 Content Too Large");
    CHECK(status(talk(port, "GET / HTTP/1.1\r\nX: " + std::string(20000, 'x'))) ==
          "HTTP/1.1 431 Request Header Fields Too Large");
    // Two requests on one connection, the second with a body.
    const std::string two = talk(port, "GET " + secret + "a HTTP/1.1\r\n" + host + "\r\nPOST " +
                                           secret + "b HTTP/1.1\r\n" + host +
                                           "Connection: close\r\nContent-Length: 4\r\n\r\nbody");
    CHECK(two.find("GET a ") != std::string::npos);
    CHECK(two.ends_with("POST b body"));
    // A hundred connections that say nothing keep nobody out.
    std::vector<int> silent;
    sockaddr_in to = here;
    to.sin_port = htons(static_cast<std::uint16_t>(port));
    for (int i = 0; i < 100; ++i) {
        silent.push_back(::socket(AF_INET, SOCK_STREAM, 0));
        REQUIRE(::connect(silent.back(), reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0);
    }
    CHECK(status(get(secret + "x", host)) == "HTTP/1.1 200 OK");
    for (const int s : silent) ::close(s);
    CHECK(status(get(secret + "x", host)) == "HTTP/1.1 200 OK");
    for (int i = 0; i < 50 && packets == 0; ++i) {
        ::sendto(udp, "abc", 3, 0, reinterpret_cast<const sockaddr*>(&here), sizeof here);
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
    CHECK(packets > 0);
    CHECK(packets < 100);
    ::close(udp);
    stop = true;
    serving.join();
}
