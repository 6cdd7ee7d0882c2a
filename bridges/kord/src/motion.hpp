// What is to be sent in this tick, if anything: decided from the newest wish, with no call to the controller.
#pragma once

#include "guard.hpp"

namespace station_kord {

// What Python asks for; the newest wins. `epoch` says which engagement it belongs to.
struct Wish {
    Mode kind = Mode::idle;  // idle: hold
    uint64_t epoch = 0;
    int64_t number = 0;  // of the targets of this engagement that differ from the one before
    Joints q{}, qd{}, qdd{};
    Pose pose{};
    double speed = 0;
};

struct Sending {
    Mode kind = Mode::idle;  // idle: nothing
    Joints q{}, qd{}, qdd{};
    Pose pose{};
    double speed = 0;
    double stop_s = 0;  // above 0: the move of that kind that runs is to end at `q`, at rest, in so long
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
    void hold(const Arm& arm);
    Sending decide(const Arm& arm, const Profile& profile, int throttle);
    // What was decided last has not left this machine: it is still to be sent.
    void unsent();

    Mode mode() const { return mode_; }
    const Joints& target() const { return target_; }
    const Counters& counters() const { return now_.counters; }
    // Whether something is still to be sent though nothing new is asked for.
    bool is_pending() const { return now_.is_dirty || mode_ == Mode::velocity || mode_ == Mode::direct; }

private:
    // What changes with each command that leaves.
    struct Progress {
        OffsetGuard guard;
        Joints q{};               // the last joints that were sent
        bool is_seeded = false;   // whether they are of this mode
        bool is_dirty = false;    // whether there is something to send
        bool is_waiting = false;  // whether that is a target which has not had its turn
        bool is_slewing = false;  // whether the guard is still on its way
        int64_t ticks_since_send = 1'000'000;
        Counters counters;
    };

    bool may_begin(const Wish& wish, const Arm& arm) const;
    bool is_allowed(const Wish& wish, const Arm& arm) const;
    bool leaps(const Wish& wish, const Arm& arm) const;
    Sending stop_of(const Arm& arm) const;
    bool is_past_goal(const Joints& q, const Arm& arm) const;
    Sending decide_stream(const Arm& arm, const Profile& profile, int throttle);
    Sending decide_velocity(const Arm& arm);
    Sending decide_direct(const Arm& arm);
    Sending decide_once(const Arm& arm);
    Sending integrate(const Joints& wanted, double dv_max_s, const Arm& arm);

    const Limits limits_;
    const bool resend_targets_;
    Mode mode_ = Mode::idle;
    Wish wish_;
    Sending once_;  // the move of the controller's own, or its stop
    Progress now_, before_;
    Joints target_{}, qd_{};
    int64_t ticks_since_wish_ = 0, taken_number_ = 0;
};

}  // namespace station_kord
