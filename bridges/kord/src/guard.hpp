// The last checks before a command leaves: joint ranges, and how far a timed target may be.
#pragma once

#include "types.hpp"

namespace station_kord {

// The first joint beyond its range, or -1.
int beyond(const Joints& values, const Joints& low, const Joints& high);

// Goes to a far target in steps that the controller's motion constraints allow in the profile's time. Each step follows
// from the one before and not from where the arm is, so it is as smooth as a stream of a steady hand.
class OffsetGuard {
public:
    void reset(const Joints& q);

    // The next target to send, `interval_s` after the one before; `target` itself where it is near enough.
    Joints next(const Joints& target, double interval_s, const Profile& profile, const Joints& qd_max);

    // A turn has passed without a target: the arm comes to rest at the last one.
    void rest() {
        qd_ = {};
        is_resting_ = true;
    }

private:
    Joints q_{}, qd_{};
    bool is_resting_ = true;
};

}  // namespace station_kord
