// What the reference does: nothing, follow a via-point, work off a queue of stop-points, obey direct commands, brake.
#pragma once

#include <deque>

#include "kinematics.hpp"
#include "segment.hpp"

namespace kordsim {

class Motion {
public:
    explicit Motion(const Options& options);

    const Reference& reference() const { return reference_; }
    const Joints& acceleration() const { return acceleration_; }
    const Joints& goal() const { return goal_; }
    bool is_moving() const;
    bool is_direct() const { return kind_ == Kind::direct; }
    double queued_s() const;

    // A move; false where it is not feasible.
    bool begin(const Command& move);

    // What the next direct command should be, if the arm went on as it does.
    Joints expected() const;
    void obey(const Command& direct);

    // Let a tick pass; false where a line has no solution.
    bool advance();

    // Forget all that is to come and come to rest as fast as the arm can.
    void brake();
    void settle();

    // Whether the last target is one that another is to replace, and not one to stop at.
    bool is_to_be_followed() const {
        return (kind_ == Kind::timed || kind_ == Kind::paced) && !stops_ && queue_.empty();
    }

    // Ticks in direct motion without a command.
    int ceased_ticks() const { return ceased_ticks_; }

private:
    enum class Kind { rest, timed, paced, line, direct, braking };

    struct Line {
        Frame from, to;
        double duration_s = 0, elapsed_s = 0;
    };

    struct Queued {
        Command move;
        double duration_s = 0;
    };

    bool is_feasible(const Joints& goal, double duration_s) const;
    bool start(const Queued& queued);
    void start_line(const Command& move, double duration_s);
    double duration_of(const Command& move, const Joints& from) const;
    bool advance_line();
    void advance_direct();
    void slow_down();
    void move_to(const Reference& next);
    bool finish();

    const Options& options_;
    Reference reference_;
    Joints acceleration_{}, goal_{};
    Kind kind_ = Kind::rest;
    Timed timed_;
    Paced paced_;
    Line line_;
    std::deque<Queued> queue_;
    double waiting_s_ = 0;
    int ceased_ticks_ = 0;
    bool was_obeyed_ = false, stops_ = false;
};

}  // namespace kordsim
