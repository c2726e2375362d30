// SPDX-License-Identifier: Apache-2.0
/// viewing/loopback.hpp: a web server for this machine alone, by Asio: it listens on 127.0.0.1,
/// answers under a secret path, and refuses requests that name another host or come from another
/// page. Everything runs on the thread of run(). In a build without Asio its constructor throws an
/// Error that states how to get it.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <rye/io/bytes.hpp>

namespace rye::trainer {

struct WebRequest {
    std::string method; ///< GET or POST
    std::string path;   ///< after the secret, such as "draw"
    std::string body;
};

struct WebAnswer {
    int status = 200;
    std::string type; ///< such as "text/html; charset=utf-8"
    std::string body;
    std::vector<std::pair<std::string, std::string>> headers; ///< further ones, on a line each
};

class LoopbackServer {
  public:
    /// Listens on the port, or on a free one for 0. `answer` is asked for each request; an Error
    /// that it throws is answered as text with the status 400. Throws an Error if the port is
    /// taken.
    LoopbackServer(int port, std::function<WebAnswer(const WebRequest&)> answer);
    ~LoopbackServer();
    LoopbackServer(const LoopbackServer&) = delete;
    LoopbackServer& operator=(const LoopbackServer&) = delete;

    int port() const;
    /// Returns the address with its secret: http://127.0.0.1:PORT/SECRET/.
    std::string address() const;

    /// Calls `take` with each packet that comes to this UDP port of 127.0.0.1. Throws an Error if
    /// the port is taken.
    void receive(int port, std::function<void(ByteSpan)> take);

    /// Answers until `stop`, which is asked ten times a second, returns true.
    void run(const std::function<bool()>& stop);

  private:
    struct Sockets;
    std::unique_ptr<Sockets> sockets_;
};

} // namespace rye::trainer
