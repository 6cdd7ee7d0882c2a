// Moves of the controller's own, which end elsewhere than in this loop: when they are over, and how they are stopped.
#include <algorithm>
#include <cmath>

#include "motion.hpp"
#include "pose.hpp"

namespace station_kord {

namespace {

constexpr double kStopS = 0.1, kLongestStopS = 1.0;  // as soon as a speed that nobody renews, or as the joints may
constexpr double kStopPeak = 1.5;                    // of a quintic from a speed to rest: deceleration times T/speed
constexpr double kFinishS = 0.15;                    // what is left of a stream may take so long when it is held
constexpr double kThere = 0.001;                     // [rad], [m]: nearer than that an arm is where its move leads
constexpr double kObeyedS = 0.08;                    // after its time a stop by which the arm still moves did not arrive
constexpr double kWatchS = 10;                       // after a stop nothing else moves the arm than what it did not stop
constexpr int kStopsAgain = 3;                       // a controller that finishes its move first would do them all

double furthest(const Joints& a, const Joints& b) {
    double way = 0;
    for (size_t joint = 0; joint < kJoints; ++joint) way = std::max(way, std::abs(a[joint] - b[joint]));
    return way;
}

}  // namespace

// What is near of a stream the controller finishes, and a speed goes down to zero; a move that it makes by itself, or a
// target far away, is replaced by one that ends soon, unless it ends as soon.
void Motion::hold(const Arm& arm) {
    ticks_since_wish_ = std::max(ticks_since_wish_, kFreshTicks);
    now_.is_waiting = false;
    stops_again_ = kStopsAgain;
    if (once_.stop_s > 0) return;  // it stops already
    const bool is_to_stop = goes_on(arm);
    now_.is_dirty = false;
    if (!is_to_stop) {
        if (is_under_way()) mode_ = Mode::idle;  // it has not left this machine
        return;
    }
    if (mode_ == Mode::stream) {
        mode_ = Mode::move_joints;
        goal_ = now_.q;
        now_.is_seeded = now_.is_slewing = false;
    }
    once_ = stop_of(arm);
    now_.is_dirty = true;
}

// Whether the arm would go on for long by what has been sent; a move may be on its way and not be seen in the arm yet.
bool Motion::goes_on(const Arm& arm) const {
    if (is_under_way()) return !now_.is_dirty;
    if (mode_ != Mode::stream || !now_.is_seeded) return false;
    if (now_.stops_at_points) return false;  // a stop would wait behind them all, and be a way back by then
    const double left = furthest(now_.q, arm.q);
    return left > kThere && (now_.pace_s > 0 ? now_.pace_s : left / now_.pace_radps) > kFinishS;
}

void Motion::lose(const Arm& arm) {
    if (is_direct() || mode_ == Mode::idle)
        reset(arm.q);
    else
        hold(arm);
}

// Half the way that the arm would go on in the time of the stop, from where it is when the command acts.
Sending Motion::stop_of(const Arm& arm) const {
    Sending stop{mode_, {}, {}, {}, {}, 0, kStopS};
    for (size_t joint = 0; joint < kJoints; ++joint)
        stop.stop_s = std::max(stop.stop_s, kStopPeak * std::abs(arm.qd[joint]) / limits_.qdd_max[joint]);
    stop.stop_s = std::min(stop.stop_s, kLongestStopS);
    const double acts_after_s = static_cast<double>(arm.passed_ticks + 1) * kTickS;  // since the arm was there
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double q = arm.q[joint] + arm.qd[joint] * (acts_after_s + stop.stop_s / 2);
        const double low = std::min(limits_.q_min[joint], arm.q[joint]);
        stop.q[joint] = std::clamp(q, low, std::max(limits_.q_max[joint], arm.q[joint]));
    }
    return stop;
}

// By the longest ways of all joints: one that stands at its goal has a measured speed too, and would tell nothing.
bool Motion::is_past_goal(const Joints& q, const Arm& arm) const {
    return mode_ == Mode::move_joints && furthest(q, arm.q) >= furthest(goal_, arm.q);
}

Sending Motion::decide_once(const Arm& arm) {
    if (!now_.is_dirty) {
        if (is_over(arm))
            mode_ = Mode::idle;
        else
            now_.is_dirty = is_unheard(arm);
        return {};
    }
    now_.is_dirty = false;
    if (once_.stop_s > 0) {  // it may be late: from where the arm is by now
        once_ = stop_of(arm);
        if (is_past_goal(once_.q, arm)) return {};
        target_ = once_.q;
    }
    return once_;
}

double Motion::since_send_s() const { return static_cast<double>(now_.ticks_since_send) * kTickS; }

// "Sent" is all that is known of a stop; where it is lost on its way the arm goes on.
bool Motion::is_unheard(const Arm& arm) {
    const bool is_stopping = once_.stop_s > 0 && stops_again_ > 0;
    if (!is_stopping || !arm.is_moving || since_send_s() <= once_.stop_s + kObeyedS) return false;
    --stops_again_;
    return true;
}

// A move that was too gentle to be seen, and whose stop was lost, is seen later.
void Motion::watch(const Arm& arm) {
    if (since_send_s() > kWatchS || !is_unheard(arm)) return;
    mode_ = once_.kind;
    now_.is_dirty = true;
}

// An arm that stands may not have begun, or begin so gently that it cannot be seen, or only in some of the ticks.
bool Motion::is_over(const Arm& arm) const {
    if (arm.is_moving || now_.ticks_since_send <= kBeginTicks) return false;
    if (once_.stop_s > 0)
        return since_send_s() > once_.stop_s + (furthest(once_.q, arm.q) < kThere ? 0.0 : kObeyedS);
    if (mode_ == Mode::move_joints) return furthest(goal_, arm.q) < kThere;
    return way_between(once_.pose, arm.tcp) < kThere && turn_between(once_.pose, arm.tcp) < kThere;
}

}  // namespace station_kord
