#include "guard.hpp"

#include <algorithm>
#include <cmath>

namespace station_kord {

namespace {

constexpr double kPeakSpeed = 1.875, kPeakAcceleration = 5.774;  // of a quintic from rest to rest: times d/T, d/T²
constexpr double kMargin = 0.9;
constexpr double kTurning = 0.5;  // of what the constraints allow, from step to step

// The greatest first step from rest [rad].
double reach(double qd_max, const Profile& profile) {
    const double duration_s = profile.tracking_value;
    const double by_speed = qd_max * duration_s / kPeakSpeed;
    const double by_acceleration = profile.guard_qdd_radps2 * duration_s * duration_s / kPeakAcceleration;
    return kMargin * std::min(by_speed, by_acceleration);
}

// How fast the next step of one joint is: towards the target, and not so fast that it cannot stop there. The speed
// falls as fast as the constraints allow, and grows and turns more gently: an arm at rest is judged harder.
double speed_of(double way, double qd, double growth, double fall_radps, double qd_max, double interval_s) {
    const double by_way = 2 * fall_radps / interval_s * std::abs(way);
    const double stoppable = std::sqrt(fall_radps * fall_radps / 4 + by_way) - fall_radps / 2;
    const double wanted = std::copysign(std::min({std::abs(way) / interval_s, stoppable, kMargin * qd_max}), way);
    const double low = std::min(qd - growth, std::max(0.0, qd - fall_radps));
    const double high = std::max(qd + growth, std::min(0.0, qd + fall_radps));
    return std::clamp(wanted, low, high);
}

}  // namespace

int beyond(const Joints& values, const Joints& low, const Joints& high) {
    for (size_t joint = 0; joint < kJoints; ++joint)
        if (!(values[joint] >= low[joint] && values[joint] <= high[joint])) return static_cast<int>(joint);
    return -1;
}

void OffsetGuard::reset(const Joints& q) {
    q_ = q;
    rest();
}

Joints OffsetGuard::next(const Joints& target, double interval_s, const Profile& profile, const Joints& qd_max) {
    for (size_t joint = 0; joint < kJoints; ++joint) {
        const double way = target[joint] - q_[joint];
        const double growth = (is_resting_ ? 1.0 : kTurning) * reach(qd_max[joint], profile) / interval_s;
        const double fall_radps = kTurning * profile.guard_qdd_radps2 * profile.tracking_value;
        qd_[joint] = speed_of(way, qd_[joint], growth, fall_radps, qd_max[joint], interval_s);
        const double step = qd_[joint] * interval_s;
        q_[joint] = std::abs(way - step) < 1e-9 ? target[joint] : q_[joint] + step;
    }
    is_resting_ = false;
    return q_;
}

}  // namespace station_kord
