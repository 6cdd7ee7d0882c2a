// What an arm may be asked for, and in which engagement.
#include <algorithm>
#include <cmath>

#include "bridge.hpp"
#include "events.hpp"
#include "guard.hpp"

namespace station_kord {

namespace {

constexpr double kSeedRad = 0.0005;  // how far a first direct command may be from the arm
constexpr double kToolMaxMps = 2.0;  // of the tool, in the example of [MOTION_CONSTRAINTS] in KORD.ini

Joints negative(Joints values) {
    for (double& value : values) value = -value;
    return values;
}

void check_speed(const std::string& what, double speed, double most, const std::string& unit) {
    if (!(speed > 0 && speed <= most))
        throw Refusal("OutOfLimits", what + ": a speed of " + number(speed) + " " + unit + " is not above 0 and " +
                                         number(most) + " " + unit + " at most");
}

void check_taking(const std::string& what, const State& state) {
    const std::string why = not_ready_text(state.motion_flags);
    if (!why.empty())
        throw Refusal("Refused", what + ": the controller takes no commands (" + why + "); see its own display");
}

const char* name_of(Mode mode) {
    switch (mode) {
        case Mode::stream: return "stream_j";
        case Mode::velocity: return "velocity_j";
        case Mode::direct: return "direct_j";
        case Mode::move_joints: return "move_j";
        case Mode::move_line: return "move_l";
        case Mode::idle: break;
    }
    return "hold";
}

}  // namespace

Joints Bridge::engage() {
    const State now = snapshot();
    if (!now.is_connected) throw Refusal("NotConnected", "there is no session; connect first");
    if (now.is_faulted) throw Refusal("Refused", "the arm is faulted; clear the faults first");
    check_taking("engage", now);
    if (now.is_moving) throw Refusal("Refused", "the arm still moves; wait until it stands");
    ++granted_;
    return now.q;
}

void Bridge::disengage() { revoke(granted_.load()); }

// Whoever comes late with an older grant does not take back what has been revoked since.
void Bridge::revoke(uint64_t granted) {
    uint64_t revoked = revoked_.load();
    while (revoked < granted && !revoked_.compare_exchange_weak(revoked, granted)) {
    }
}

void Bridge::hold() { post(wish_of(Mode::idle)); }

void Bridge::check_ready(const State& state, Mode wanted) const {
    const std::string what = name_of(wanted);
    if (!state.is_connected) throw Refusal("NotConnected", what + ": there is no session; connect first");
    if (state.is_faulted) throw Refusal("Refused", what + ": the arm is faulted; clear the faults, then engage");
    check_taking(what, state);
    if (!is_engaged()) throw Refusal("Refused", what + ": not engaged; engage first");
    const bool is_one_shot = wanted == Mode::move_joints || wanted == Mode::move_line;
    if (state.is_moving && (state.mode != wanted || is_one_shot) && state.mode != Mode::idle)
        throw Refusal("Refused", what + ": the arm still moves by " + name_of(state.mode) + "; wait until it stands");
}

void Bridge::check_joints(const char* what, const Joints& values, const Joints& low, const Joints& high,
                          const char* unit) const {
    const int joint = beyond(values, low, high);
    if (joint < 0) return;
    const auto at = static_cast<size_t>(joint);
    throw Refusal("OutOfLimits", std::string(what) + ": joint " + std::to_string(joint + 1) + " at " +
                                     number(values[at]) + " " + unit + " is outside " + number(low[at]) + " to " +
                                     number(high[at]) + " " + unit);
}

// Of a motion that comes to rest by itself when nobody renews it.
void Bridge::check_speeds(const char* what, const Joints& qd) const {
    check_joints(what, qd, negative(limits_.qd_max), limits_.qd_max, "rad/s");
    for (size_t joint = 0; joint < kJoints; ++joint)
        if (std::abs(qd[joint]) > kFastestRadps)
            throw Refusal("OutOfLimits", std::string(what) + ": joint " + std::to_string(joint + 1) + " at " +
                                             number(qd[joint]) + " rad/s is faster than " + number(kFastestRadps) +
                                             " rad/s, from which it can come to rest within 100 ms without a torque "
                                             "deviation (1010)");
}

// To be made before anything is looked at: a command belongs to the engagement in which it was asked for.
Wish Bridge::wish_of(Mode kind) const {
    Wish wish;
    wish.kind = kind;
    wish.epoch = granted_;
    return wish;
}

void Bridge::post(Wish wish) {
    const std::lock_guard lock(writers_mutex_);
    const bool is_hold = wish.kind == Mode::idle;
    if (is_hold) wish.epoch = granted_;
    if (wish.epoch < posted_.epoch) return;  // its engagement has ended since it was asked for
    const bool goes_on = wish.epoch == posted_.epoch;
    const bool is_same = goes_on && posted_.kind == Mode::stream && wish.q == posted_.q;
    wish.number = goes_on ? posted_.number : 0;
    wish.holds = (goes_on ? posted_.holds : 0) + is_hold;
    if (wish.kind == Mode::stream && !is_same) ++wish.number;
    posted_ = wish;
    wishes_.write(wish);
}

void Bridge::stream_j(const Joints& q) {
    Wish wish = wish_of(Mode::stream);
    check_ready(snapshot(), Mode::stream);
    check_joints("stream_j", q, limits_.q_min, limits_.q_max, "rad");
    wish.q = q;
    post(wish);
}

void Bridge::velocity_j(const Joints& qd) {
    Wish wish = wish_of(Mode::velocity);
    check_ready(snapshot(), Mode::velocity);
    check_speeds("velocity_j", qd);
    wish.qd = qd;
    post(wish);
}

void Bridge::direct_j(const Joints& q, const Joints& qd, const Joints& qdd) {
    Wish wish = wish_of(Mode::direct);
    const State now = snapshot();
    check_ready(now, Mode::direct);
    check_joints("direct_j", q, limits_.q_min, limits_.q_max, "rad");
    check_speeds("direct_j", qd);
    check_joints("direct_j", qdd, negative(limits_.qdd_max), limits_.qdd_max, "rad/s²");
    for (size_t joint = 0; joint < kJoints && now.mode != Mode::direct; ++joint)
        if (std::abs(q[joint] - now.q[joint]) > kSeedRad)
            throw Refusal("Refused", "direct_j: the first command must be where the arm is; joint " +
                                         std::to_string(joint + 1) + " is at " + number(now.q[joint]) + " rad, not " +
                                         number(q[joint]));
    wish.q = q;
    wish.qd = qd;
    wish.qdd = qdd;
    post(wish);
}

void Bridge::move_j(const Joints& q, double speed_radps) {
    Wish wish = wish_of(Mode::move_joints);
    check_ready(snapshot(), Mode::move_joints);
    check_joints("move_j", q, limits_.q_min, limits_.q_max, "rad");
    const double limit = *std::min_element(limits_.qd_max.begin(), limits_.qd_max.end());
    check_speed("move_j", speed_radps, limit, "rad/s");
    wish.q = q;
    wish.speed = speed_radps;
    post(wish);
}

void Bridge::move_l(const Pose& pose, double speed_mps) {
    Wish wish = wish_of(Mode::move_line);
    check_ready(snapshot(), Mode::move_line);
    if (!std::all_of(pose.begin(), pose.end(), [](double value) { return std::isfinite(value); }))
        throw Refusal("BadOption", "move_l: six finite numbers are needed, x y z roll pitch yaw");
    check_speed("move_l", speed_mps, kToolMaxMps, "m/s");
    wish.pose = pose;
    wish.speed = speed_mps;
    post(wish);
}

}  // namespace station_kord
