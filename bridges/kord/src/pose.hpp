// How far apart two poses of the tool are.
#pragma once

#include "types.hpp"

namespace station_kord {

double way_between(const Pose& a, const Pose& b);  // of the points [m]

// The angle of the rotation from one to the other [rad]: roll, pitch and yaw have two spellings of each.
double turn_between(const Pose& a, const Pose& b);

}  // namespace station_kord
