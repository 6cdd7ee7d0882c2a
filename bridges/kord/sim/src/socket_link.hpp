// A session with a controller in another process.
#pragma once

#include <string>

#include "session.hpp"

namespace kordsim {

class SocketLink : public Link {
public:
    explicit SocketLink(std::string path) : path_(std::move(path)) {}
    ~SocketLink() override { close(); }

    bool open(std::chrono::milliseconds timeout, Status& first) override;
    void close() override;
    bool wait(std::chrono::microseconds timeout, Status& heard) override;
    bool send(const Command& command) override;
    bool send(const Clear& clear) override;

private:
    bool connect();
    bool await_readable(int64_t until_ns) const;

    std::string path_;
    int socket_ = -1;
};

}  // namespace kordsim
