#include "segment.hpp"

#include <algorithm>
#include <cmath>

namespace kordsim {

namespace {

constexpr double kArrivedRad = 1e-5;

}  // namespace

double distance(const Joints& from, const Joints& to) {
    double furthest = 0;
    for (int joint = 0; joint < kJoints; ++joint) furthest = std::max(furthest, std::abs(to[joint] - from[joint]));
    return furthest;
}

bool is_moving(const Joints& qd) {
    return std::any_of(qd.begin(), qd.end(), [](double speed) { return std::abs(speed) > kMovingRadps; });
}

void Timed::begin(const Reference& from, const Joints& goal, double duration_s) {
    from_ = from;
    goal_ = goal;
    duration_s_ = duration_s;
    elapsed_s_ = 0;
}

Reference Timed::advance(double dt_s) {
    elapsed_s_ = std::min(elapsed_s_ + dt_s, duration_s_);
    if (is_done()) return {goal_, {}};
    const double s = elapsed_s_ / duration_s_, s2 = s * s, s3 = s2 * s, s4 = s3 * s, s5 = s4 * s;
    Reference now;
    for (int joint = 0; joint < kJoints; ++joint) {
        const double d = goal_[joint] - from_.q[joint], w = from_.qd[joint] * duration_s_;
        now.q[joint] = from_.q[joint] + d * (10 * s3 - 15 * s4 + 6 * s5) + w * (s - 6 * s3 + 8 * s4 - 3 * s5);
        const double slope = d * 30 * (s2 - 2 * s3 + s4) + w * (1 - 18 * s2 + 32 * s3 - 15 * s4);
        now.qd[joint] = slope / duration_s_;
    }
    return now;
}

void Paced::begin(const Joints& goal, double speed_radps, double blend_s) {
    goal_ = goal;
    speed_radps_ = speed_radps;
    blend_s_ = std::max(blend_s, kTickS);
    is_done_ = false;
}

Reference Paced::advance(const Reference& from, double dt_s) {
    const double left = distance(from.q, goal_);
    const double braking = *std::max_element(from.qd.begin(), from.qd.end(),
                                             [](double a, double b) { return std::abs(a) < std::abs(b); });
    if (left < kArrivedRad && std::abs(braking) * dt_s <= 2 * kArrivedRad) {
        is_done_ = true;
        return {goal_, {}};
    }
    const double speed = std::min(speed_radps_, left / blend_s_);
    const double change = speed_radps_ / blend_s_ * dt_s;
    Reference now;
    for (int joint = 0; joint < kJoints; ++joint) {
        const double wanted = left > 0 ? (goal_[joint] - from.q[joint]) / left * speed : 0.0;
        now.qd[joint] = std::clamp(wanted, from.qd[joint] - change, from.qd[joint] + change);
        now.q[joint] = from.q[joint] + now.qd[joint] * dt_s;
    }
    return now;
}

double Paced::remaining_s(const Joints& q) const {
    return is_done_ ? 0.0 : distance(q, goal_) / speed_radps_ + blend_s_;
}

}  // namespace kordsim
