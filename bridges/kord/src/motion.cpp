#include "motion.hpp"

#include <algorithm>
#include <cmath>

namespace station_kord {

namespace {

constexpr int64_t kMadeUpTicks = 2;  // between direct commands: one that is missing the controller makes up for
// Controllers take a direct command that is 0.6 mrad from where the one before led for a torque deviation (1010). A
// change of speed by 0.1 rad/s in a tick is 0.4 mrad. One that is lost unseen makes three changes of one, which there is
// time for while a speed grows, and before a range ends.
constexpr double kQddMaxRadps2 = 0.1 / kTickS, kGentleMaxRadps2 = 0.045 / kTickS;
constexpr double kJumpRad = 0.0005;  // less than that
constexpr double kRounding = 1 + 1e-9;

bool stands(const Joints& qd) {
    return std::all_of(qd.begin(), qd.end(), [](double speed) { return speed == 0; });
}

// The speed of the next tick: it may fall faster than it may grow.
double towards(double wanted, double qd, double growth, double fall) {
    const double low = std::min(qd - growth, std::max(0.0, qd - fall));
    return std::clamp(wanted, low, std::max(qd + growth, std::min(0.0, qd + fall)));
}

// Down along a line that ends when `left` ticks have passed, or as soon after it as may be.
double falling(double qd, double left) {
    const double wanted = qd * std::max(0.0, left - 1) / std::max(1.0, left);
    return std::clamp(wanted, qd - kFallMaxRadps, qd + kFallMaxRadps);
}

// The speed at which a joint can still stop before its range ends.
double stoppable(double speed, double q, double low, double high, double qdd_max) {
    const double room = std::max(0.0, (speed > 0 ? high - q : q - low) - std::abs(speed) * kTickS);
    return std::clamp(speed, -std::sqrt(2 * qdd_max * room), std::sqrt(2 * qdd_max * room));
}

}  // namespace

void Motion::reset(const Joints& q) {
    mode_ = Mode::idle;
    wish_ = {};
    once_ = {};
    target_ = now_.q = q;
    now_.qd = {};
    now_.guard.reset(q);
    now_.is_dirty = now_.is_waiting = now_.is_slewing = now_.is_seeded = now_.is_owed = false;
    ticks_since_wish_ = kSilentTicks;
    taken_number_ = taken_holds_ = 0;
}

void Motion::take(const Wish& wish, const Arm& arm) {
    const bool is_stream = wish.kind == Mode::stream;
    const int64_t unseen = std::max<int64_t>(0, wish.number - taken_number_ - 1);
    const bool is_new = wish.number > taken_number_;
    taken_number_ = wish.number;
    const bool is_held = wish.holds > taken_holds_;
    taken_holds_ = wish.holds;
    if (is_held) hold(arm);
    if (wish.kind == Mode::idle) return;
    if (!may_begin(wish, arm) || !is_allowed(wish, arm)) {
        ++now_.counters.refused;
        return;
    }
    if (is_stream && is_new) now_.counters.dropped += unseen + now_.is_waiting;
    if (wish.kind != mode_) now_.is_seeded = now_.is_slewing = false;
    mode_ = wish.kind;
    const bool is_unsent = wish.q != now_.q || !now_.is_seeded || now_.is_slewing;
    now_.is_dirty = is_stream ? is_unsent : wish.kind != Mode::velocity;
    now_.is_waiting = is_stream && now_.is_dirty && (is_new || now_.is_waiting);
    if (mode_ != Mode::velocity && mode_ != Mode::move_line) target_ = wish.q;
    once_ = {mode_, wish.q, {}, {}, wish.pose, wish.speed, 0};
    goal_ = wish.q;
    wish_ = wish;
    ticks_since_wish_ = 0;
}

bool Motion::may_begin(const Wish& wish, const Arm& arm) const {
    if (wish.kind == mode_ && !is_under_way()) return true;
    return !arm.is_moving && !is_pending();
}

bool Motion::is_allowed(const Wish& wish, const Arm& arm) const {
    if (wish.kind == Mode::velocity || wish.kind == Mode::move_line) return true;
    return beyond(wish.q, limits_.q_min, limits_.q_max) < 0 && !(wish.kind == Mode::direct && leaps(wish, arm));
}

// Whether a direct command asks for more than the joints may do in a tick, from where and how fast the last one was.
bool Motion::leaps(const Wish& wish, const Arm& arm) const {
    const bool goes_on = mode_ == Mode::direct && now_.is_seeded;
    const Joints q = goes_on ? now_.q : arm.q, qd = goes_on ? now_.qd : Joints{};
    const double since_s = kTickS * static_cast<double>(arm.passed_ticks) * kRounding;
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double way = std::abs(wish.q[joint] - q[joint]), change = std::abs(wish.qd[joint] - qd[joint]);
        if (!(way <= limits_.qd_max[joint] * since_s && change <= limits_.qdd_max[joint] * since_s)) return true;
    }
    return false;
}

Sending Motion::decide(const Arm& arm, const Profile& profile, int throttle) {
    now_.ticks_since_send += arm.passed_ticks;
    if (!now_.is_owed) {
        now_.left_q = now_.q;
        now_.left_qd = now_.qd;
    }
    before_ = now_;
    Sending sending;
    switch (mode_) {
        case Mode::idle: watch(arm); break;
        case Mode::stream: sending = decide_stream(arm, profile, throttle); break;
        case Mode::velocity: sending = decide_velocity(arm); break;
        case Mode::direct: sending = decide_direct(arm); break;
        case Mode::move_joints:
        case Mode::move_line: sending = decide_once(arm); break;
    }
    ticks_since_wish_ += arm.passed_ticks;
    if (sending.kind == Mode::idle) return sending;
    if (is_jump(sending)) {
        cut_off();
        return {};
    }
    now_.ticks_since_send = 0;
    now_.is_owed = false;
    return sending;
}

// A direct command that is missing is made up for by the controller, so the next one goes on from it.
void Motion::unsent() {
    if (!before_.is_seeded || !is_direct()) {
        now_ = before_;
        return;
    }
    now_.is_owed = true;
    now_.ticks_since_send = before_.ticks_since_send;
}

// Where more than one is missing the arm comes to rest where the last one led, and what goes on from it is far ahead.
bool Motion::is_jump(const Sending& sending) const {
    if (sending.kind != Mode::direct || !before_.is_seeded || now_.ticks_since_send <= kMadeUpTicks) return false;
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double led = now_.left_q[joint] + now_.left_qd[joint] * kTickS;
        if (!(std::abs(sending.q[joint] - led) <= kJumpRad)) return true;
    }
    return false;
}

// A velocity goes on from where the arm is once it stands; direct commands are their caller's, who has to begin anew.
void Motion::cut_off() {
    ++now_.counters.refused;
    now_.is_seeded = now_.is_dirty = now_.is_owed = false;
    target_ = now_.q = now_.left_q;
    now_.qd = {};
    if (mode_ == Mode::direct) mode_ = Mode::idle;
}

// A target waits for its turn, and a newer one takes its place; so the last one of a motion is always sent.
Sending Motion::decide_stream(const Arm& arm, const Profile& profile, int throttle) {
    if ((!now_.is_dirty && !resend_targets_) || now_.ticks_since_send < throttle) return {};
    Sending sending{Mode::stream, target_, {}, {}, {}, 0, 0};
    now_.is_dirty = now_.is_waiting = now_.is_slewing = false;
    if (!now_.is_seeded) now_.guard.reset(arm.q);  // what moved the arm since then was no stream
    if (profile.tracks_time && profile.offset_guard) {
        if (now_.ticks_since_send > throttle) now_.guard.rest();
        sending.q = now_.guard.next(target_, throttle * kTickS, profile, limits_.qd_max);
        now_.is_dirty = now_.is_slewing = sending.q != target_;
        now_.counters.slewed += now_.is_slewing;
    } else {
        now_.guard.reset(sending.q);
    }
    now_.q = sending.q;
    now_.is_seeded = true;
    now_.pace_s = profile.tracks_time ? profile.tracking_value : 0.0;
    now_.pace_radps = profile.tracking_value;
    now_.stops_at_points = profile.stops_at_points;
    return sending;
}

Sending Motion::decide_velocity(const Arm& arm) {
    if (!now_.is_seeded) {  // the first direct command after another mode must be where the arm is, and it stands
        if (arm.is_moving) {
            if (ticks_since_wish_ > kFreshTicks) mode_ = Mode::idle;
            return {};
        }
        now_.is_seeded = true;
        now_.is_callers = false;
        now_.q = arm.q;
        now_.qd = {};
        return {Mode::direct, now_.q, now_.qd, {}, {}, 0, 0};
    }
    return integrate(wish_.qd, kTickS, arm);
}

Sending Motion::decide_direct(const Arm& arm) {
    if (now_.is_dirty) {
        now_.is_dirty = false;
        now_.is_seeded = now_.is_callers = true;
        now_.q = wish_.q;
        now_.qd = wish_.qd;
        return {Mode::direct, wish_.q, wish_.qd, wish_.qdd, {}, 0, 0};
    }
    return integrate(now_.qd, 0.0, arm);
}

// What the controller did where one command is missing: the next one goes on from it. A caller's own that has not left is
// still to leave as it is.
int64_t Motion::make_up(int64_t passed_ticks) {
    if (now_.ticks_since_send != kMadeUpTicks || (now_.is_owed && now_.is_callers)) return passed_ticks;
    for (size_t joint = 0; joint < kJoints; ++joint) now_.q[joint] = now_.left_q[joint] + now_.left_qd[joint] * kTickS;
    now_.qd = now_.left_qd;
    return 1;
}

// Goes on at the wanted speed; `dv_max_s` times an acceleration is how fast the speed may change. When nobody has asked
// for a while the speed goes down along a line that ends in time; once the command with a zero has left, none follows.
Sending Motion::integrate(const Joints& wanted, double dv_max_s, const Arm& arm) {
    const double left = static_cast<double>(kSilentTicks - ticks_since_wish_);
    const bool is_fresh = ticks_since_wish_ <= kFreshTicks;
    const bool is_over = stands(now_.qd) && (!is_fresh || stands(wanted)) && !now_.is_owed;
    if (is_over) {
        mode_ = Mode::idle;
        target_ = now_.q;
        return {};
    }
    const double ticks = static_cast<double>(make_up(arm.passed_ticks));
    now_.is_callers = false;
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double qdd_max = std::min(limits_.qdd_max[joint], kQddMaxRadps2);
        const double gentle = std::min(qdd_max, kGentleMaxRadps2);
        double& qd = now_.qd[joint];
        double speed = is_fresh ? towards(wanted[joint], qd, gentle * dv_max_s, qdd_max * dv_max_s) : falling(qd, left);
        if (dv_max_s > 0 || !is_fresh)
            speed = stoppable(speed, now_.q[joint], limits_.q_min[joint], limits_.q_max[joint], gentle);
        qd = std::abs(speed) < 1e-9 ? 0.0 : speed;
        const double next = now_.q[joint] + qd * kTickS * ticks;
        const double low = std::min(limits_.q_min[joint], now_.left_q[joint]);  // it may stand beyond its range
        now_.q[joint] = std::clamp(next, low, std::max(limits_.q_max[joint], now_.left_q[joint]));
    }
    target_ = now_.q;
    return {Mode::direct, now_.q, now_.qd, {}, {}, 0, 0};
}

}  // namespace station_kord
