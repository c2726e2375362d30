// SPDX-License-Identifier: Apache-2.0
#include "viewing/loopback.hpp"

#include <rye/core/error.hpp>

#ifdef RYE_ASIO
#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <random>

#include <asio.hpp>
#endif

namespace rye::trainer {

#ifdef RYE_ASIO
namespace {

using asio::ip::tcp;
using asio::ip::udp;
using Seconds = std::chrono::seconds;

constexpr std::size_t most_header = 1U << 14U, most_body = 1U << 20U;
constexpr std::size_t most_connections = 32;
constexpr Seconds patience{30}; // for a request to arrive, and between requests

/// Returns 32 hexadecimal digits that nobody guesses.
std::string new_secret() {
    std::random_device random;
    std::string digits;
    for (int i = 0; i < 4; ++i) {
        std::uint32_t word = random();
        for (int k = 0; k < 8; ++k, word >>= 4U) digits += "0123456789abcdef"[word & 15U];
    }
    return digits;
}

std::string lower(std::string_view text) {
    std::string out(text);
    std::transform(out.begin(), out.end(), out.begin(), [](char c) {
        return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
    });
    return out;
}

const char* reason(int status) {
    switch (status) {
        case 200:
            return "OK";
        case 400:
            return "Bad Request";
        case 403:
            return "Forbidden";
        case 404:
            return "Not Found";
        case 405:
            return "Method Not Allowed";
        case 413:
            return "Content Too Large";
        case 431:
            return "Request Header Fields Too Large";
        default:
            return "Internal Server Error";
    }
}

/// A request's first line and fields, or the status that refuses it.
struct Head {
    std::string method, path, host, origin;
    std::size_t body = 0;
    bool keep = true;
    int refused = 0;
};

Head head_of(std::string_view text) {
    Head h;
    const auto line = [&] {
        const std::size_t end = text.find("\r\n");
        const std::string_view l = text.substr(0, end);
        text.remove_prefix(std::min(text.size(), end + 2));
        return l;
    };
    const std::string_view first = line();
    const std::size_t a = first.find(' '), b = first.rfind(' ');
    if (a == std::string_view::npos || b <= a + 1 || !first.substr(b + 1).starts_with("HTTP/1.")) {
        h.refused = 400;
        return h;
    }
    h.method = first.substr(0, a);
    h.path = first.substr(a + 1, b - a - 1);
    h.keep = first.ends_with("1.1");
    for (std::string_view l = line(); !l.empty(); l = line()) {
        const std::size_t colon = l.find(':');
        if (colon == std::string_view::npos) {
            h.refused = 400;
            return h;
        }
        const std::string name = lower(l.substr(0, colon));
        std::string_view value = l.substr(colon + 1);
        while (value.starts_with(' ') || value.starts_with('\t')) value.remove_prefix(1);
        while (value.ends_with(' ') || value.ends_with('\t')) value.remove_suffix(1);
        if (name == "host") h.host = lower(value);
        if (name == "origin") h.origin = lower(value);
        if (name == "connection" && lower(value) == "close") h.keep = false;
        if (name == "transfer-encoding") h.refused = 400;
        if (name == "content-length") {
            const auto [end, fault] =
                std::from_chars(value.data(), value.data() + value.size(), h.body);
            if (fault != std::errc() || end != value.data() + value.size()) h.refused = 400;
            if (h.body > most_body) h.refused = 413;
        }
    }
    if (h.refused == 0 && h.method != "GET" && h.method != "POST") h.refused = 405;
    return h;
}

} // namespace

struct LoopbackServer::Sockets {
    struct Connection;
    std::vector<Connection*> connections; ///< that exist; outlives the context, which ends them
    asio::io_context context{1};
    tcp::acceptor acceptor{context};
    std::unique_ptr<udp::socket> packets;
    std::array<char, 65536> packet{};
    std::function<WebAnswer(const WebRequest&)> answer;
    std::function<void(ByteSpan)> take;
    std::string secret = new_secret();
    int port = 0;

    /// A browser's connection, on which requests follow one another.
    struct Connection : std::enable_shared_from_this<Connection> {
        Connection(Sockets& s, tcp::socket c) : all(s), socket(std::move(c)), timer(s.context) {
            all.connections.push_back(this);
        }
        ~Connection() { std::erase(all.connections, this); }
        Connection(const Connection&) = delete;
        Connection& operator=(const Connection&) = delete;

        void wait() {
            last = std::chrono::steady_clock::now();
            timer.expires_after(patience);
            timer.async_wait([self = shared_from_this()](const asio::error_code& e) {
                if (!e) self->close();
            });
        }
        void close() {
            asio::error_code ignored;
            timer.cancel();
            socket.close(ignored);
        }
        void read() {
            wait();
            asio::async_read_until(
                socket, asio::dynamic_buffer(text, most_header), "\r\n\r\n",
                [self = shared_from_this()](const asio::error_code& e, std::size_t size) {
                    if (e == asio::error::not_found) return self->refuse(431);
                    if (e) return self->close();
                    self->head = head_of(std::string_view(self->text).substr(0, size - 2));
                    self->text.erase(0, size);
                    self->read_body();
                });
        }
        void read_body() {
            if (head.refused != 0) return refuse(head.refused);
            if (text.size() >= head.body) return respond();
            asio::async_read(socket, asio::dynamic_buffer(text),
                             asio::transfer_exactly(head.body - text.size()),
                             [self = shared_from_this()](const asio::error_code& e, std::size_t) {
                                 if (e) return self->close();
                                 self->respond();
                             });
        }
        void refuse(int status) {
            head.keep = false;
            write({status, "text/plain; charset=utf-8", std::string(reason(status)) + "\n", {}});
        }
        void respond() {
            WebRequest request{head.method, "", text.substr(0, head.body)};
            text.erase(0, head.body);
            const std::string own = "127.0.0.1:" + std::to_string(all.port),
                              named = "localhost:" + std::to_string(all.port);
            const std::string root = "/" + all.secret + "/";
            if (head.host != own && head.host != named) return refuse(403);
            if (!head.origin.empty() && head.origin != "http://" + own &&
                head.origin != "http://" + named)
                return refuse(403);
            if (!head.path.starts_with(root)) return refuse(404);
            request.path = head.path.substr(root.size());
            WebAnswer made;
            try {
                made = all.answer(request);
            } catch (const Error& e) {
                made = {400, "text/plain; charset=utf-8", e.what(), {}};
            }
            write(made);
        }
        void write(const WebAnswer& a) {
            out = "HTTP/1.1 " + std::to_string(a.status) + " " + reason(a.status) +
                  "\r\nContent-Type: " + a.type +
                  "\r\nContent-Length: " + std::to_string(a.body.size()) +
                  "\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff"
                  "\r\nReferrer-Policy: no-referrer\r\nConnection: " +
                  (head.keep ? "keep-alive" : "close") + "\r\n";
            for (const auto& [name, value] : a.headers) out += name + ": " + value + "\r\n";
            out += "\r\n";
            out += a.body;
            wait();
            asio::async_write(socket, asio::buffer(out),
                              [self = shared_from_this()](const asio::error_code& e, std::size_t) {
                                  if (e || !self->head.keep) return self->close();
                                  self->read();
                              });
        }

        Sockets& all;
        tcp::socket socket;
        asio::steady_timer timer;
        std::chrono::steady_clock::time_point last; ///< of the last news
        std::string text, out;
        Head head;
    };

    /// Closes the connection without news for the longest time if there are too many.
    void make_room() {
        if (connections.size() < most_connections) return;
        const auto oldest = std::min_element(
            connections.begin(), connections.end(),
            [](const Connection* a, const Connection* b) { return a->last < b->last; });
        (*oldest)->close(); // its handlers, which are called soon, let it go
    }

    void accept() {
        acceptor.async_accept([this](const asio::error_code& e, tcp::socket socket) {
            if (e == asio::error::operation_aborted) return;
            asio::error_code ignored;
            if (!e) socket.set_option(tcp::no_delay(true), ignored);
            if (!e) {
                make_room();
                std::make_shared<Connection>(*this, std::move(socket))->read();
            }
            accept();
        });
    }
    void receive() {
        packets->async_receive(asio::buffer(packet),
                               [this](const asio::error_code& e, std::size_t size) {
                                   if (e == asio::error::operation_aborted) return;
                                   if (!e) take(as_bytes(std::string_view(packet.data(), size)));
                                   receive();
                               });
    }
};

LoopbackServer::LoopbackServer(int port, std::function<WebAnswer(const WebRequest&)> answer)
    : sockets_(std::make_unique<Sockets>()) {
    Sockets& s = *sockets_;
    s.answer = std::move(answer);
    try {
        const tcp::endpoint here(asio::ip::address_v4::loopback(),
                                 static_cast<asio::ip::port_type>(port));
        s.acceptor.open(here.protocol());
#ifndef _WIN32 // where it lets two programs share a port
        s.acceptor.set_option(tcp::acceptor::reuse_address(true));
#endif
        s.acceptor.bind(here);
        s.acceptor.listen();
        s.port = s.acceptor.local_endpoint().port();
    } catch (const std::system_error& e) {
        throw Error("--port: got " + std::to_string(port) +
                    ", which cannot be listened on: " + e.what());
    }
    s.accept();
}

LoopbackServer::~LoopbackServer() = default;

int LoopbackServer::port() const { return sockets_->port; }

std::string LoopbackServer::address() const {
    return "http://127.0.0.1:" + std::to_string(sockets_->port) + "/" + sockets_->secret + "/";
}

void LoopbackServer::receive(int port, std::function<void(ByteSpan)> take) {
    Sockets& s = *sockets_;
    s.take = std::move(take);
    try {
        s.packets = std::make_unique<udp::socket>(
            s.context, udp::endpoint(asio::ip::address_v4::loopback(),
                                     static_cast<asio::ip::port_type>(port)));
    } catch (const std::system_error& e) {
        throw Error("--osc: got " + std::to_string(port) +
                    ", which cannot be listened on: " + e.what());
    }
    s.receive();
}

void LoopbackServer::run(const std::function<bool()>& stop) {
    while (!stop()) sockets_->context.run_for(std::chrono::milliseconds(100));
}

#else

struct LoopbackServer::Sockets {};

LoopbackServer::LoopbackServer(int, std::function<WebAnswer(const WebRequest&)>) {
    throw Error("rye view: this program was built without Asio (Debian: libasio-dev)");
}
LoopbackServer::~LoopbackServer() = default;
int LoopbackServer::port() const { return 0; }
std::string LoopbackServer::address() const { return {}; }
void LoopbackServer::receive(int, std::function<void(ByteSpan)>) {}
void LoopbackServer::run(const std::function<bool()>&) {}

#endif

} // namespace rye::trainer
