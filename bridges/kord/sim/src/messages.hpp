// What goes between a session and a controller, within a process or through a socket: plain structs of fixed size.
#pragma once

#include <cstdint>
#include <type_traits>

#include "options.hpp"

namespace kordsim {

// Motion flags, safety flags and alarm categories as the controller's words have them.
constexpr uint32_t kStandby = 1, kTracking = 2, kHalt = 8, kSuspended = 32, kPaused = 1024;
constexpr uint32_t kEstop = 2, kSstop = 8, kUserConfirmation = 16;
constexpr uint32_t kSafetyCategory = 1, kSoftStopCategory = 2, kHardwareCategory = 3, kCbunCategory = 4;

enum class CommandKind : int32_t { move_joints, move_line, direct };
enum class Tracking : int32_t { time, joint_speed, tool_speed };

struct Command {
    CommandKind kind = CommandKind::move_joints;
    Tracking tracking = Tracking::time;
    Joints q{};  // of a line: the pose in the first six
    Joints qd{};
    double tracking_value = 0;
    double blend_s = 0;
    int64_t tick = 0;      // of the heartbeat that it answers
    double offset_us = 0;  // since that heartbeat
    int32_t stops_at_point = 0;
    int32_t was_fetched = 0;  // whether the status had been read before
};

struct Clear {
    int32_t what = 0;  // EClearRequest
    int32_t unused = 0;
    int64_t token = 0;
};

struct ToldEvent {
    int64_t time_ns = 0;
    uint32_t id = 0;
    uint32_t group = 0;
};

struct Acknowledged {
    int64_t token = 0;
    int64_t code = 0;
};

constexpr int kToldEvents = 7, kAcknowledged = 8;

struct Status {
    int64_t tick = 0;
    int64_t time_ns = 0;
    Joints q{}, qd{}, qdd{}, torque{};
    Pose tcp{};
    uint32_t motion_flags = kStandby;
    uint32_t safety_flags = 0;
    uint32_t alarm = 0;
    int32_t safety_mode = 1;
    double master_speed = 1.0;
    double queued_motion_s = 0;
    int32_t planner_backlog = 0;
    int32_t event_count = 0;
    std::array<ToldEvent, kToldEvents> events{};
    std::array<Acknowledged, kAcknowledged> acknowledged{};
    int64_t late_commands = 0;
    int64_t is_lost = 0;  // the session ended by a fault; nothing more will come
    int64_t is_opaque = 0;  // nobody is to look at what kord-api does not tell
};

static_assert(std::is_trivially_copyable_v<Command> && std::is_trivially_copyable_v<Clear>);
static_assert(std::is_trivially_copyable_v<Status>);

}  // namespace kordsim
