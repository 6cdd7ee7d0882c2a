// How the reference gets from one place to another.
#pragma once

#include "messages.hpp"

namespace kordsim {

struct Reference {
    Joints q{}, qd{};
};

// The greatest distance of any joint.
double distance(const Joints& from, const Joints& to);

// Whether any joint is faster than what counts as motion.
bool is_moving(const Joints& qd);

// A motion that takes a given time: a quintic from where the arm is, as fast as it is, to rest at the goal.
class Timed {
public:
    void begin(const Reference& from, const Joints& goal, double duration_s);
    Reference advance(double dt_s);
    bool is_done() const { return elapsed_s_ >= duration_s_ - 1e-9; }
    double remaining_s() const { return is_done() ? 0.0 : duration_s_ - elapsed_s_; }
    const Joints& goal() const { return goal_; }

private:
    Reference from_;
    Joints goal_{};
    double duration_s_ = 0, elapsed_s_ = 0;
};

// Motion at a given speed of the joint with the furthest to go, which takes as long as it takes; it speeds up, slows
// down and turns within the blend time.
class Paced {
public:
    void begin(const Joints& goal, double speed_radps, double blend_s);
    Reference advance(const Reference& from, double dt_s);
    bool is_done() const { return is_done_; }
    double remaining_s(const Joints& q) const;
    const Joints& goal() const { return goal_; }

private:
    Joints goal_{};
    double speed_radps_ = 0, blend_s_ = 0;
    bool is_done_ = true;
};

}  // namespace kordsim
