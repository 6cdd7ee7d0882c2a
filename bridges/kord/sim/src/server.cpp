#include "server.hpp"

#include <fcntl.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "packets.hpp"

namespace kordsim {

namespace {

constexpr int64_t kStallTicks = 5;

bool somebody_listens(const sockaddr_un& address) {
    const int probe = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    const bool answers = ::connect(probe, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
    ::close(probe);
    return answers;
}

}  // namespace

Server::Server(std::string path, std::shared_ptr<Plant> plant, int real_time_priority)
    : path_(std::move(path)), plant_(std::move(plant)), real_time_priority_(real_time_priority) {}

Server::~Server() { stop(); }

std::string Server::start() {
    if (thread_.joinable()) return "";
    const std::string problem = listen();
    if (!problem.empty()) return problem;
    is_stopping_ = false;
    thread_ = std::thread([this] { run(); });
    return "";
}

void Server::stop() {
    if (!thread_.joinable()) return;
    is_stopping_ = true;
    const char byte = 0;
    while (::write(wake_[1], &byte, 1) < 0 && errno == EINTR) {
    }
    thread_.join();
    for (int* descriptor : {&listener_, &wake_[0], &wake_[1]}) {
        ::close(*descriptor);
        *descriptor = -1;
    }
    ::unlink(path_.c_str());
}

std::string Server::listen() {
    sockaddr_un address{};
    address.sun_family = AF_UNIX;
    if (path_.empty() || path_.size() >= sizeof address.sun_path)
        return "a socket's path has 1 to " + std::to_string(sizeof address.sun_path - 1) + " characters";
    std::memcpy(address.sun_path, path_.c_str(), path_.size());
    if (somebody_listens(address)) return "another controller listens there already";
    ::unlink(path_.c_str());
    listener_ = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (::bind(listener_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
        ::listen(listener_, 4) != 0 || ::pipe2(wake_, O_CLOEXEC) != 0) {
        const std::string reason = std::strerror(errno);
        ::close(listener_);
        return reason;
    }
    return "";
}

void Server::run() {
    sched_param wanted{};
    wanted.sched_priority = real_time_priority_;
    if (real_time_priority_ > 0) pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
    int64_t next_ns = monotonic_ns() + kTickNs;
    Packet heartbeat(PacketKind::heartbeat);
    while (!is_stopping_) {
        const int64_t left_ns = std::max<int64_t>(0, next_ns - monotonic_ns());
        const timespec left{0, left_ns};
        pollfd wanted[3] = {{wake_[0], POLLIN, 0}, {listener_, POLLIN, 0}, {client_, POLLIN, 0}};
        if (ppoll(wanted, 3, &left, nullptr) > 0) {
            if (wanted[2].revents) hear();
            if (wanted[1].revents) admit();
        }
        const int64_t now_ns = monotonic_ns();
        if (now_ns < next_ns) continue;
        // When this process was stopped itself, nobody else is to blame for that time.
        if (now_ns - next_ns > kStallTicks * kTickNs) next_ns = now_ns;
        const bool goes_out = plant_->tick(next_ns, heartbeat.status);
        if (goes_out && client_ >= 0) send_packet(client_, heartbeat);
        next_ns += kTickNs;
    }
    part();
}

void Server::admit() {
    const int socket = ::accept4(listener_, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
    if (socket < 0) return;
    if (client_ >= 0) hear();  // the one before may have just gone
    if (client_ >= 0) {
        send_packet(socket, Packet(PacketKind::busy));
        ::close(socket);
        return;
    }
    client_ = socket;
    has_client_ = true;
    plant_->open();
}

void Server::hear() {
    Packet packet;
    Received what;
    while ((what = take_packet(client_, packet)) == Received::packet) {
        if (packet.kind == PacketKind::hello) {
            Packet welcome(PacketKind::welcome);
            welcome.status = plant_->look();
            send_packet(client_, welcome);
        } else if (packet.kind == PacketKind::waited) {
            plant_->waited();
        } else if (packet.kind == PacketKind::command) {
            plant_->receive(packet.command);
        } else if (packet.kind == PacketKind::clear) {
            plant_->receive(packet.clear);
        }
    }
    if (what == Received::gone) part();
}

void Server::part() {
    if (client_ < 0) return;
    ::close(client_);
    client_ = -1;
    has_client_ = false;
    plant_->close();
}

}  // namespace kordsim
