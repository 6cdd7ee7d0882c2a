// What is to be sent in this tick, if anything: decided from the newest wish, with no call to the controller.
#pragma once

#include "guard.hpp"

namespace station_kord {

// What Python asks for; the newest wins. `epoch` says which engagement it belongs to.
struct Wish {
    Mode kind = Mode::idle;  // idle: hold
    uint64_t epoch = 0;
    int64_t number = 0;  // of the targets of this session, for counting those that were replaced
    Joints q{}, qd{}, qdd{};
    Pose pose{};
    double speed = 0;
};

struct Sending {
    Mode kind = Mode::idle;  // idle: nothing
    Joints q{}, qd{}, qdd{};
    Pose pose{};
    double speed = 0;
};

// What the arm does, as far as it is known in this tick.
struct Arm {
    Joints q{}, qd{};
    bool is_moving = false;
    int64_t passed_ticks = 1;  // since the last decision
};

struct Counters {
    int64_t dropped = 0, slewed = 0, refused = 0;
};

class Motion {
public:
    Motion(const Limits& limits, bool resend_targets) : limits_(limits), resend_targets_(resend_targets) {}

    // Forget everything; the target is where the arm is.
    void reset(const Joints& q);
    void take(const Wish& wish, const Arm& arm);
    Sending decide(const Arm& arm, const Profile& profile, int throttle);

    Mode mode() const { return mode_; }
    const Joints& target() const { return target_; }
    const Counters& counters() const { return counters_; }
    // Whether something is still to be sent though nothing new is asked for.
    bool is_pending() const { return is_dirty_ || mode_ == Mode::velocity || mode_ == Mode::direct; }

private:
    bool may_begin(const Wish& wish, const Arm& arm);
    Sending decide_stream(const Profile& profile, int throttle);
    Sending decide_velocity(const Arm& arm);
    Sending decide_direct(const Arm& arm);
    Sending decide_once(const Arm& arm);
    Sending integrate(const Joints& wanted, double dv_max_s, const Arm& arm);

    const Limits limits_;
    const bool resend_targets_;
    Mode mode_ = Mode::idle;
    Wish wish_;
    OffsetGuard guard_;
    Joints target_{}, q_{}, qd_{};
    bool is_dirty_ = false, is_seeded_ = false;
    int64_t ticks_since_send_ = 1'000'000, ticks_since_wish_ = 0, sent_number_ = 0;
    Counters counters_;
};

}  // namespace station_kord
