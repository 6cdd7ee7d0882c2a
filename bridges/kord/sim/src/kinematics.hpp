// Where the tool of a KR810 is, and which joints bring it somewhere.
#pragma once

#include "options.hpp"

namespace kordsim {

struct Frame {
    std::array<double, 3> p{};
    std::array<double, 9> r{1, 0, 0, 0, 1, 0, 0, 0, 1};  // row by row
};

Frame forward(const Joints& q);
Pose to_pose(const Frame& frame);    // x y z roll pitch yaw
Frame to_frame(const Pose& pose);

// The rotation between two frames as a vector: its axis times its angle [rad].
std::array<double, 3> rotation_between(const Frame& from, const Frame& to);

// A frame on the way: the point on the straight line, the rotation about one axis.
Frame between(const Frame& from, const Frame& to, double share);

// Joints near `q` whose tool is at `goal`; false where a few damped steps do not get there.
bool solve(Joints& q, const Frame& goal);

}  // namespace kordsim
