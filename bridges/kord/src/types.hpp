// What Python hands over and what it gets back: plain structs; station_kord says what each field means.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>

namespace station_kord {

constexpr int kJoints = 7;
constexpr double kTickS = 0.004;
constexpr int64_t kTickNs = 4'000'000;
constexpr int kEvents = 8;

using Joints = std::array<double, kJoints>;
using Pose = std::array<double, 6>;

struct Limits {
    Joints q_min{}, q_max{}, qd_max{}, qdd_max{};
};

struct Profile {
    std::array<char, 32> name{};
    bool tracks_time = false;  // otherwise a joint speed
    double tracking_value = 0.3;
    bool blends = true;
    double blend_s = 0.008;
    bool stops_at_points = false;
    int throttle = 2;
    bool offset_guard = false;
    double guard_qdd_radps2 = 0;
    bool sim_only = false;
};

// What only a simulated controller can tell.
struct Insight {
    double queued_motion_s = 0;
    int planner_backlog = 0;
    int64_t late_commands = 0;
};

// What differs between a controller and a simulated one, other than kord-api itself; empty for a real one.
struct Hooks {
    std::function<int64_t()> now_ns;    // its clock; CLOCK_MONOTONIC where empty
    std::function<bool(int64_t)> step;  // lets a virtual clock go on; empty where there is none
    std::function<void(bool)> run_free;  // whether it stops nobody
};

struct BridgeConfig {
    std::string host = "sim";
    int port = 7582;
    int session_id = 1;
    Joints q_min{}, q_max{}, qd_max{}, qdd_max{};
    Profile profile;
    bool is_simulated = false;
    bool fetch_first = false;
    bool resend_targets = false;
    int real_time_priority = 0;
    bool lock_memory = false;
    int trace_ticks = 0;
};

enum class Mode : int32_t { idle, stream, velocity, direct, move_joints, move_line };

struct Timing {
    double last = 0, p50 = 0, p99 = 0, max = 0;
};

struct Event {
    int64_t number = 0, tick = 0, mono_ns = 0;
    uint32_t id = 0;
    uint32_t group = 0;  // 1 safety, 2 soft stop, 3 kord, 4 hardware, 5 connection
};

struct State {
    Mode mode = Mode::idle;
    std::array<char, 32> profile{};
    int throttle = 1;
    bool is_connected = false, is_engaged = false, is_faulted = false, is_moving = false;
    bool needs_user_confirmation = false, sched_fifo_granted = false, memory_locked = false;
    int64_t mono_ns = 0;
    double session_age_s = 0;
    Joints q{}, qd{}, qdd{}, torque{}, q_target{}, q_sent{};
    Pose tcp_pose{};
    double queued_motion_s = 0;
    int planner_backlog = -1;
    int64_t tick = 0, stream_j_sends = 0, direct_sends = 0, move_sends = 0, commands_dropped_by_throttle = 0;
    int64_t failed_sends = 0, slewed_sends = 0, limit_refusals = 0, sync_timeouts = 0, missed_ticks = 0;
    int64_t late_commands = 0;
    int64_t fault_count = 0, trace_skipped = 0;
    Timing sync_to_send_us, period_us;
    uint32_t motion_flags = 0, safety_flags = 0, alarm_state = 0;
    int safety_mode = 0;
    double master_speed = 0;
    int event_count = 0;
    std::array<Event, kEvents> events{};
};

// What a caller did that cannot be; `kind` is the name of the Python class.
struct Refusal : std::runtime_error {
    Refusal(const char* kind_, const std::string& text) : std::runtime_error(text), kind(kind_) {}
    const char* kind;
};

}  // namespace station_kord
