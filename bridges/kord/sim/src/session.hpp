// What the stand-in for kord-api does its work with: a session with a plant of this process, or through a socket.
#pragma once

#include <chrono>
#include <memory>
#include <string>

#include "messages.hpp"

namespace kordsim {

class Plant;

class Link {
public:
    virtual ~Link() = default;
    virtual bool open(std::chrono::milliseconds timeout, Status& first) = 0;
    virtual void close() = 0;
    virtual bool wait(std::chrono::microseconds timeout, Status& heard) = 0;
    virtual bool send(const Command& command) = 0;
    virtual bool send(const Clear& clear) = 0;
};

// ``unix:PATH``, the name of a plant, or any other: a plant of its own with the usual options.
std::unique_ptr<Link> link_to(const std::string& host);

class Session {
public:
    explicit Session(const std::string& host);
    ~Session();

    bool open();
    void close();
    bool sync();
    bool wait(std::chrono::microseconds timeout);
    bool send(Command command);
    int64_t send_clear(int32_t what);
    void fetch();

    const Status& heard() const { return heard_; }      // of the last heartbeat
    const Status& fetched() const { return fetched_; }  // what the receiver shows

private:
    std::unique_ptr<Link> link_;
    Status heard_, fetched_;
    int64_t heard_ns_ = 0, token_ = 0;
    bool is_open_ = false, was_fetched_ = false;
};

}  // namespace kordsim
