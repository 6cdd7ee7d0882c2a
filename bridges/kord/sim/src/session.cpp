#include "session.hpp"

#include "plant.hpp"
#include "socket_link.hpp"

namespace kordsim {

namespace {

constexpr std::chrono::milliseconds kOpening{2000};
const std::string kSocket = "unix:";

class LocalLink : public Link {
public:
    explicit LocalLink(std::shared_ptr<Plant> plant) : plant_(std::move(plant)) {}

    bool open(std::chrono::milliseconds, Status& first) override {
        plant_->open();
        first = plant_->look();
        return true;
    }
    void close() override { plant_->close(); }
    bool wait(std::chrono::microseconds timeout, Status& heard) override { return plant_->wait(timeout, heard); }
    bool send(const Command& command) override {
        Command sent = command;
        if (plant_->options().is_virtual) sent.offset_us = 0;  // no virtual time passes between a heartbeat and its answer
        return plant_->receive(sent);
    }
    bool send(const Clear& clear) override {
        plant_->receive(clear);
        return true;
    }

private:
    std::shared_ptr<Plant> plant_;
};

}  // namespace

std::unique_ptr<Link> link_to(const std::string& host) {
    const bool is_socket = host.compare(0, kSocket.size(), kSocket) == 0;
    if (is_socket) return std::make_unique<SocketLink>(host.substr(kSocket.size()));
    auto plant = find(host);
    return std::make_unique<LocalLink>(plant ? plant : std::make_shared<Plant>(Options{}));
}

Session::Session(const std::string& host) : link_(link_to(host)) {}

Session::~Session() { close(); }

bool Session::open() {
    close();
    is_open_ = link_->open(kOpening, heard_);
    return is_open_;
}

void Session::close() {
    if (is_open_) link_->close();
    is_open_ = false;
}

bool Session::sync() { return is_open_; }

bool Session::wait(std::chrono::microseconds timeout) {
    if (!is_open_) {  // as long as any heartbeat that does not come
        sleep_until(monotonic_ns() + timeout.count() * 1000);
        return false;
    }
    if (!link_->wait(timeout, heard_)) return false;
    heard_ns_ = monotonic_ns();
    was_fetched_ = false;
    return true;
}

bool Session::send(Command command) {
    if (!is_open_) return false;
    command.tick = heard_.tick;
    command.offset_us = static_cast<double>(monotonic_ns() - heard_ns_) * 1e-3;
    command.was_fetched = was_fetched_;
    return link_->send(command);
}

int64_t Session::send_clear(int32_t what) {
    if (!is_open_ || !link_->send(Clear{what, 0, ++token_})) return 0;
    return token_;
}

void Session::fetch() {
    fetched_ = heard_;
    was_fetched_ = true;
}

}  // namespace kordsim
