// What is to be sent in this tick, if anything: decided from the newest wish, with no call to the controller.
#pragma once

#include "guard.hpp"

namespace station_kord {

constexpr int64_t kFreshTicks = 5;  // 20 ms: a writer at 50 Hz never lets the speed sag
constexpr int64_t kBeginTicks = 5;  // until a command that was sent can be seen in the arm's speed
constexpr int64_t kSilentTicks = 25;  // 100 ms: by then an arm whose speed nobody renews stands

// How much of a speed may go in a tick: 0.56 mrad, of the 0.6 that controllers take for a torque deviation.
constexpr double kFallMaxRadps = 0.14;
constexpr double kFastestRadps = kFallMaxRadps * (kSilentTicks - kFreshTicks - 1);  // which can go in time

// What Python asks for; the newest wins. `epoch` says which engagement it belongs to.
struct Wish {
    Mode kind = Mode::idle;  // idle: hold
    uint64_t epoch = 0;
    int64_t number = 0;  // of the targets of this engagement that differ from the one before
    int64_t holds = 0;   // asked for in this engagement by then: what is asked for next does not undo one
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
    Pose tcp{};
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
    // The session is lost: what goes on without it is stopped when it comes back.
    void lose(const Arm& arm);
    Sending decide(const Arm& arm, const Profile& profile, int throttle);
    // What was decided last has not left this machine: it is still to be sent.
    void unsent();

    Mode mode() const { return mode_; }
    const Joints& target() const { return target_; }
    const Counters& counters() const { return now_.counters; }
    // Whether something is still to be sent, or a move of the controller's own to end, though nothing new is asked for.
    bool is_pending() const { return now_.is_dirty || is_direct() || is_under_way(); }
    // Whether a move of the controller's own is not known to have ended; it may not even be seen to have begun.
    bool is_under_way() const { return mode_ == Mode::move_joints || mode_ == Mode::move_line; }

private:
    // What changes with each command that leaves.
    struct Progress {
        OffsetGuard guard;
        Joints q{}, qd{};            // the last joints and speeds that were to be sent
        Joints left_q{}, left_qd{};  // of a direct motion: the last that left this machine
        bool is_seeded = false;      // whether they are of this mode
        bool is_dirty = false;       // whether there is something to send
        bool is_waiting = false;     // whether that is a target which has not had its turn
        bool is_slewing = false;     // whether the guard is still on its way
        bool is_callers = false;     // of a direct motion: whether they were asked for, and not made here
        bool is_owed = false;        // whether a direct command has not left, and must not be the last
        int64_t ticks_since_send = 1'000'000;
        double pace_radps = 0, pace_s = 0;  // of the last target of a stream: the speed or the time that it was given
        bool stops_at_points = false;       // and whether it waits until the arm stands at the one before
        Counters counters;
    };

    bool is_direct() const { return mode_ == Mode::velocity || mode_ == Mode::direct; }
    bool may_begin(const Wish& wish, const Arm& arm) const;
    bool is_allowed(const Wish& wish, const Arm& arm) const;
    bool leaps(const Wish& wish, const Arm& arm) const;
    bool goes_on(const Arm& arm) const;
    Sending stop_of(const Arm& arm) const;
    bool is_past_goal(const Joints& q, const Arm& arm) const;
    bool is_unheard(const Arm& arm);
    void watch(const Arm& arm);
    double since_send_s() const;
    bool is_over(const Arm& arm) const;
    Sending decide_stream(const Arm& arm, const Profile& profile, int throttle);
    Sending decide_velocity(const Arm& arm);
    Sending decide_direct(const Arm& arm);
    Sending decide_once(const Arm& arm);
    int64_t make_up(int64_t passed_ticks);
    Sending integrate(const Joints& wanted, double dv_max_s, const Arm& arm);
    bool is_jump(const Sending& sending) const;
    void cut_off();

    const Limits limits_;
    const bool resend_targets_;
    Mode mode_ = Mode::idle;
    Wish wish_;
    Sending once_;            // the move of the controller's own, or its stop
    Joints goal_{};           // where that move leads, if it is one of joints
    int stops_again_ = 0;     // how often its stop is still to be sent again, where the arm moves on
    Progress now_, before_;
    Joints target_{};
    int64_t ticks_since_wish_ = 0, taken_number_ = 0, taken_holds_ = 0;
};

}  // namespace station_kord
