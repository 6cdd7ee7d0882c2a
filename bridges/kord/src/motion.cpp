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
    target_ = q_ = q;
    qd_ = {};
    guard_.reset(q);
    is_dirty_ = is_seeded_ = false;
    ticks_since_wish_ = kSilentTicks;
}

bool Motion::may_begin(const Wish& wish, const Arm& arm) {
    if (wish.kind == mode_ && wish.kind != Mode::move_joints && wish.kind != Mode::move_line) return true;
    if (!arm.is_moving && !is_pending()) return true;
    ++counters_.refused;
    return false;
}

void Motion::take(const Wish& wish, const Arm& arm) {
    if (wish.kind == Mode::idle) {  // hold: what the controller has is finished, a speed goes down to zero
        is_dirty_ = false;
        ticks_since_wish_ = std::max(ticks_since_wish_, kFreshTicks);
        return;
    }
    if (!may_begin(wish, arm)) return;
    const bool has_joints = wish.kind != Mode::velocity && wish.kind != Mode::move_line;
    if (has_joints && beyond(wish.q, limits_.q_min, limits_.q_max) >= 0) {
        ++counters_.refused;
        return;
    }
    if (wish.kind != mode_) is_seeded_ = false;
    mode_ = wish.kind;
    is_dirty_ = mode_ != Mode::stream || wish.q != q_ || !is_seeded_ || is_dirty_;
    if (has_joints) target_ = wish.q;
    wish_ = wish;
    ticks_since_wish_ = 0;
}

Sending Motion::decide(const Arm& arm, const Profile& profile, int throttle) {
    ticks_since_send_ += arm.passed_ticks;
    Sending sending;
    switch (mode_) {
        case Mode::idle: break;
        case Mode::stream: sending = decide_stream(profile, throttle); break;
        case Mode::velocity: sending = decide_velocity(arm); break;
        case Mode::direct: sending = decide_direct(arm); break;
        case Mode::move_joints:
        case Mode::move_line: sending = decide_once(arm); break;
    }
    ticks_since_wish_ += arm.passed_ticks;
    if (sending.kind != Mode::idle) ticks_since_send_ = 0;
    return sending;
}

// A target waits for its turn, and a newer one takes its place; so the last one of a motion is always sent.
Sending Motion::decide_stream(const Profile& profile, int throttle) {
    if ((!is_dirty_ && !resend_targets_) || ticks_since_send_ < throttle) return {};
    Sending sending{Mode::stream, target_, {}, {}, {}, 0};
    is_dirty_ = false;
    if (wish_.number > sent_number_) counters_.dropped += wish_.number - sent_number_ - 1;
    sent_number_ = std::max(sent_number_, wish_.number);
    if (profile.tracks_time && profile.offset_guard) {
        if (ticks_since_send_ > throttle) guard_.rest();
        sending.q = guard_.next(target_, throttle * kTickS, profile, limits_.qd_max);
        is_dirty_ = sending.q != target_;
        counters_.slewed += is_dirty_;
    } else {
        guard_.reset(sending.q);
    }
    q_ = sending.q;
    is_seeded_ = true;
    return sending;
}

Sending Motion::decide_velocity(const Arm& arm) {
    if (!is_seeded_) {  // the first direct command after another mode must be where the arm is
        is_seeded_ = true;
        q_ = arm.q;
        qd_ = {};
        return {Mode::direct, q_, qd_, {}, {}, 0};
    }
    return integrate(wish_.qd, kTickS, arm);
}

Sending Motion::decide_direct(const Arm& arm) {
    if (is_dirty_) {
        is_dirty_ = false;
        is_seeded_ = true;
        q_ = wish_.q;
        qd_ = wish_.qd;
        return {Mode::direct, wish_.q, wish_.qd, wish_.qdd, {}, 0};
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
        target_ = q_;
        return {};
    }
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double qdd_max = std::min(limits_.qdd_max[joint], kQddMaxRadps2), change = qdd_max * dv_max_s;
        double speed = is_fresh ? std::clamp(wanted[joint], qd_[joint] - change, qd_[joint] + change)
                                : qd_[joint] * std::max(0.0, left - 1) / std::max(1.0, left);
        if (dv_max_s > 0 || !is_fresh)
            speed = stoppable(speed, q_[joint], limits_.q_min[joint], limits_.q_max[joint], qdd_max);
        qd_[joint] = std::abs(speed) < 1e-9 ? 0.0 : speed;
        const double next = q_[joint] + qd_[joint] * kTickS * static_cast<double>(arm.passed_ticks);
        const double low = std::min(limits_.q_min[joint], q_[joint]), high = std::max(limits_.q_max[joint], q_[joint]);
        q_[joint] = std::clamp(next, low, high);
    }
    target_ = q_;
    return {Mode::direct, q_, qd_, {}, {}, 0};
}

Sending Motion::decide_once(const Arm& arm) {
    if (!is_dirty_) {
        if (ticks_since_send_ > kBeginTicks && !arm.is_moving) mode_ = Mode::idle;
        return {};
    }
    is_dirty_ = false;
    return {mode_, wish_.q, {}, {}, wish_.pose, wish_.speed};
}

}  // namespace station_kord
