#include "packets.hpp"

#include <sys/socket.h>

#include <cerrno>

namespace kordsim {

bool send_packet(int socket, const Packet& packet) {
    return ::send(socket, &packet, sizeof packet, MSG_DONTWAIT | MSG_NOSIGNAL) == sizeof packet;
}

Received take_packet(int socket, Packet& packet) {
    const ssize_t length = ::recv(socket, &packet, sizeof packet, MSG_DONTWAIT);
    if (length < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) return Received::nothing;
    return length == sizeof packet && packet.version == kPacketVersion ? Received::packet : Received::gone;
}

}  // namespace kordsim
