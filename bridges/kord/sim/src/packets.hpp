// What travels through the socket of a controller with a process of its own: one struct per packet.
#pragma once

#include "messages.hpp"

namespace kordsim {

enum class PacketKind : uint32_t { hello = 1, waited, command, clear, welcome, busy, heartbeat };

constexpr uint32_t kPacketVersion = 0x4b524402;  // "KRD" 2: both ends are of one build

struct Packet {
    PacketKind kind = PacketKind::hello;
    uint32_t version = kPacketVersion;
    union {
        Command command;
        Clear clear;
        Status status;
    };

    Packet() : status() {}
    explicit Packet(PacketKind what) : kind(what), status() {}
};

static_assert(std::is_trivially_copyable_v<Packet>);

// Sends without waiting; false where nobody is there or the other end is behind by a whole buffer.
bool send_packet(int socket, const Packet& packet);

enum class Received { packet, nothing, gone };

// Takes a packet that is there, without waiting. A packet of another build counts as gone.
Received take_packet(int socket, Packet& packet);

}  // namespace kordsim
