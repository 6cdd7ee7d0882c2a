#include "motion.hpp"

#include <algorithm>
#include <cmath>

namespace station_kord {

namespace {

constexpr int64_t kFreshTicks = 5;    // 20 ms: a writer at 50 Hz never lets the speed sag
constexpr int64_t kSilentTicks = 25;  // 100 ms: by then the arm stands
constexpr int64_t kBeginTicks = 5;    // a move that was sent has begun by then
// Controllers take a direct command that is 0.6 mrad from where the one before led for a torque deviation (1010). A
// change of speed by 0.1 rad/s in a tick is 0.4 mrad.
constexpr double kQddMaxRadps2 = 0.1 / kTickS;
constexpr double kRounding = 1 + 1e-9;
constexpr double kStopS = 0.1, kLongestStopS = 1.0;  // as soon as a speed that nobody renews, or as the joints may
constexpr double kStopPeak = 1.5;                    // of a quintic from a speed to rest: deceleration times T/speed
constexpr double kActsAfterS = 2 * kTickS;           // since the state that a command was made of

bool is_one_shot(Mode mode) { return mode == Mode::move_joints || mode == Mode::move_line; }

bool stands(const Joints& qd) {
    return std::all_of(qd.begin(), qd.end(), [](double speed) { return speed == 0; });
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
    qd_ = {};
    now_.guard.reset(q);
    now_.is_dirty = now_.is_waiting = now_.is_slewing = now_.is_seeded = false;
    ticks_since_wish_ = kSilentTicks;
    taken_number_ = 0;
}

void Motion::take(const Wish& wish, const Arm& arm) {
    const bool is_stream = wish.kind == Mode::stream;
    const int64_t unseen = std::max<int64_t>(0, wish.number - taken_number_ - 1);
    const bool is_new = wish.number > taken_number_;
    taken_number_ = wish.number;
    if (wish.kind == Mode::idle) return hold(arm);
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
    wish_ = wish;
    ticks_since_wish_ = 0;
}

bool Motion::may_begin(const Wish& wish, const Arm& arm) const {
    if (wish.kind == mode_ && !is_one_shot(mode_)) return true;
    return !arm.is_moving && !is_pending();
}

bool Motion::is_allowed(const Wish& wish, const Arm& arm) const {
    if (wish.kind == Mode::velocity || wish.kind == Mode::move_line) return true;
    return beyond(wish.q, limits_.q_min, limits_.q_max) < 0 && !(wish.kind == Mode::direct && leaps(wish, arm));
}

// Whether a direct command asks for more than the joints may do in a tick, from where and how fast the last one was.
bool Motion::leaps(const Wish& wish, const Arm& arm) const {
    const bool goes_on = mode_ == Mode::direct && now_.is_seeded;
    const Joints q = goes_on ? now_.q : arm.q, qd = goes_on ? qd_ : Joints{};
    const double since_s = kTickS * static_cast<double>(arm.passed_ticks) * kRounding;
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double way = std::abs(wish.q[joint] - q[joint]), change = std::abs(wish.qd[joint] - qd[joint]);
        if (!(way <= limits_.qd_max[joint] * since_s && change <= limits_.qdd_max[joint] * since_s)) return true;
    }
    return false;
}

// What the controller has of a stream it finishes, a speed goes down to zero, and a move that it makes by itself is
// replaced by one that ends soon; unless it ends as soon.
void Motion::hold(const Arm& arm) {
    ticks_since_wish_ = std::max(ticks_since_wish_, kFreshTicks);
    now_.is_waiting = false;
    if (once_.stop_s > 0) return;  // it stops already
    const bool was_sent = is_one_shot(mode_) && !now_.is_dirty;
    const Sending stop = stop_of(arm);
    now_.is_dirty = was_sent && arm.is_moving && !is_past_goal(stop.q, arm);
    if (!now_.is_dirty) return;
    once_ = stop;
    target_ = stop.q;
}

// Half the way that the arm would go on in the time of the stop, from where it is when the command acts.
Sending Motion::stop_of(const Arm& arm) const {
    Sending stop{mode_, {}, {}, {}, {}, 0, kStopS};
    for (size_t joint = 0; joint < kJoints; ++joint)
        stop.stop_s = std::max(stop.stop_s, kStopPeak * std::abs(arm.qd[joint]) / limits_.qdd_max[joint]);
    stop.stop_s = std::min(stop.stop_s, kLongestStopS);
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double q = arm.q[joint] + arm.qd[joint] * (kActsAfterS + stop.stop_s / 2);
        const double low = std::min(limits_.q_min[joint], arm.q[joint]);
        stop.q[joint] = std::clamp(q, low, std::max(limits_.q_max[joint], arm.q[joint]));
    }
    return stop;
}

// By the longest ways of all joints: one that stands at its goal has a measured speed too, and would tell nothing.
bool Motion::is_past_goal(const Joints& q, const Arm& arm) const {
    if (mode_ != Mode::move_joints) return false;
    double way = 0, left = 0;
    for (size_t joint = 0; joint < kJoints; ++joint) {
        way = std::max(way, std::abs(q[joint] - arm.q[joint]));
        left = std::max(left, std::abs(wish_.q[joint] - arm.q[joint]));
    }
    return way > left;
}

Sending Motion::decide(const Arm& arm, const Profile& profile, int throttle) {
    now_.ticks_since_send += arm.passed_ticks;
    before_ = now_;
    Sending sending;
    switch (mode_) {
        case Mode::idle: break;
        case Mode::stream: sending = decide_stream(arm, profile, throttle); break;
        case Mode::velocity: sending = decide_velocity(arm); break;
        case Mode::direct: sending = decide_direct(arm); break;
        case Mode::move_joints:
        case Mode::move_line: sending = decide_once(arm); break;
    }
    ticks_since_wish_ += arm.passed_ticks;
    if (sending.kind != Mode::idle) now_.ticks_since_send = 0;
    return sending;
}

// A direct command that is missing is made up for by the controller, so the next one goes on from it.
void Motion::unsent() {
    const bool goes_on = before_.is_seeded && (mode_ == Mode::velocity || mode_ == Mode::direct);
    if (!goes_on) now_ = before_;
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
    return sending;
}

Sending Motion::decide_velocity(const Arm& arm) {
    if (!now_.is_seeded) {  // the first direct command after another mode must be where the arm is
        now_.is_seeded = true;
        now_.q = arm.q;
        qd_ = {};
        return {Mode::direct, now_.q, qd_, {}, {}, 0, 0};
    }
    return integrate(wish_.qd, kTickS, arm);
}

Sending Motion::decide_direct(const Arm& arm) {
    if (now_.is_dirty) {
        now_.is_dirty = false;
        now_.is_seeded = true;
        now_.q = wish_.q;
        qd_ = wish_.qd;
        return {Mode::direct, wish_.q, wish_.qd, wish_.qdd, {}, 0, 0};
    }
    return integrate(qd_, 0.0, arm);
}

// Goes on at the wanted speed; `dv_max_s` times an acceleration is how fast the speed may change. When nobody has asked
// for a while the speed goes down along a line that ends in time, and at zero the sending ends with it.
Sending Motion::integrate(const Joints& wanted, double dv_max_s, const Arm& arm) {
    const double left = static_cast<double>(kSilentTicks - ticks_since_wish_);
    const bool is_fresh = ticks_since_wish_ <= kFreshTicks;
    const bool is_over = stands(qd_) && (!is_fresh || stands(wanted));
    if (is_over) {
        mode_ = Mode::idle;
        target_ = now_.q;
        return {};
    }
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double qdd_max = std::min(limits_.qdd_max[joint], kQddMaxRadps2), change = qdd_max * dv_max_s;
        double speed = is_fresh ? std::clamp(wanted[joint], qd_[joint] - change, qd_[joint] + change)
                                : qd_[joint] * std::max(0.0, left - 1) / std::max(1.0, left);
        if (dv_max_s > 0 || !is_fresh)
            speed = stoppable(speed, now_.q[joint], limits_.q_min[joint], limits_.q_max[joint], qdd_max);
        qd_[joint] = std::abs(speed) < 1e-9 ? 0.0 : speed;
        const double next = now_.q[joint] + qd_[joint] * kTickS * static_cast<double>(arm.passed_ticks);
        const double low = std::min(limits_.q_min[joint], now_.q[joint]);
        now_.q[joint] = std::clamp(next, low, std::max(limits_.q_max[joint], now_.q[joint]));
    }
    target_ = now_.q;
    return {Mode::direct, now_.q, qd_, {}, {}, 0, 0};
}

Sending Motion::decide_once(const Arm& arm) {
    if (!now_.is_dirty) {
        if (now_.ticks_since_send > kBeginTicks && !arm.is_moving) mode_ = Mode::idle;
        return {};
    }
    now_.is_dirty = false;
    return once_;
}

}  // namespace station_kord
