#include "pose.hpp"

#include <cmath>

namespace station_kord {

namespace {

using Quaternion = std::array<double, 4>;  // w x y z

// About the base's x, then y, then z.
Quaternion quaternion_of(const Pose& pose) {
    const double cr = std::cos(pose[3] / 2), sr = std::sin(pose[3] / 2), cp = std::cos(pose[4] / 2);
    const double sp = std::sin(pose[4] / 2), cy = std::cos(pose[5] / 2), sy = std::sin(pose[5] / 2);
    return {cr * cp * cy + sr * sp * sy, sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy};
}

double length(const Quaternion& a, const Quaternion& b, double sign) {
    double squares = 0;
    for (size_t part = 0; part < a.size(); ++part) squares += (a[part] - sign * b[part]) * (a[part] - sign * b[part]);
    return std::sqrt(squares);
}

}  // namespace

double way_between(const Pose& a, const Pose& b) { return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); }

double turn_between(const Pose& a, const Pose& b) {
    const Quaternion p = quaternion_of(a), q = quaternion_of(b);
    const double chord = std::fmin(length(p, q, 1), length(p, q, -1));  // a rotation is two quaternions
    return 4 * std::asin(std::fmin(1.0, chord / 2));
}

}  // namespace station_kord
