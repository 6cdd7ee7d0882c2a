#include "socket_link.hpp"

#include <poll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <ctime>

#include "packets.hpp"
#include "plant.hpp"

namespace kordsim {

bool SocketLink::connect() {
    sockaddr_un address{};
    if (path_.empty() || path_.size() >= sizeof address.sun_path) return false;
    address.sun_family = AF_UNIX;
    std::memcpy(address.sun_path, path_.c_str(), path_.size());
    socket_ = ::socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0);
    return socket_ >= 0 && ::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
}

bool SocketLink::open(std::chrono::milliseconds timeout, Status& first) {
    const int64_t until_ns = monotonic_ns() + timeout.count() * 1'000'000;
    Packet packet(PacketKind::hello);
    if (!connect() || !send_packet(socket_, packet)) {
        close();
        return false;
    }
    while (await_readable(until_ns)) {
        const Received what = take_packet(socket_, packet);
        if (what == Received::packet && packet.kind == PacketKind::welcome) {
            first = packet.status;
            return true;
        }
        if (what == Received::gone || packet.kind == PacketKind::busy) break;
    }
    close();
    return false;
}

void SocketLink::close() {
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
}

// Heartbeats that came while nobody waited are lost, but for the newest if it is of this very tick.
bool SocketLink::wait(std::chrono::microseconds timeout, Status& heard) {
    const int64_t until_ns = monotonic_ns() + timeout.count() * 1000;
    if (socket_ < 0 || !send_packet(socket_, Packet(PacketKind::waited))) {
        sleep_until(until_ns);
        return false;
    }
    Packet packet;
    while (await_readable(until_ns)) {
        bool has_fresh = false;
        Received what;
        while ((what = take_packet(socket_, packet)) == Received::packet) {
            if (packet.kind != PacketKind::heartbeat) continue;
            heard = packet.status;
            has_fresh = monotonic_ns() - heard.time_ns < kTickNs;
        }
        if (has_fresh) return true;
        if (what == Received::gone) {
            sleep_until(until_ns);
            return false;
        }
    }
    return false;
}

bool SocketLink::await_readable(int64_t until_ns) const {
    for (;;) {
        const int64_t left_ns = until_ns - monotonic_ns();
        if (left_ns <= 0) return false;
        const timespec left{left_ns / 1'000'000'000, left_ns % 1'000'000'000};
        pollfd wanted{socket_, POLLIN, 0};
        const int ready = ppoll(&wanted, 1, &left, nullptr);
        if (ready > 0) return true;
        if (ready == 0 || errno != EINTR) return false;
    }
}

bool SocketLink::send(const Command& command) {
    Packet packet(PacketKind::command);
    packet.command = command;
    return socket_ >= 0 && send_packet(socket_, packet);
}

bool SocketLink::send(const Clear& clear) {
    Packet packet(PacketKind::clear);
    packet.clear = clear;
    return socket_ >= 0 && send_packet(socket_, packet);
}

}  // namespace kordsim
