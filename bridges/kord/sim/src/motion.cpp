#include "motion.hpp"

#include <algorithm>
#include <cmath>

namespace kordsim {

namespace {

constexpr double kPeakSpeed = 1.875, kPeakAcceleration = 5.774;  // of a quintic from rest to rest: times d/T, d/T²
constexpr double kRounding = 1 + 1e-9;

Joints joints_of(const Frame& goal, Joints near) {
    solve(near, goal);
    return near;
}

Frame line_goal(const Command& move) {
    return to_frame({move.q[0], move.q[1], move.q[2], move.q[3], move.q[4], move.q[5]});
}

}  // namespace

Motion::Motion(const Options& options) : options_(options) { reference_.q = goal_ = options.q_start; }

bool Motion::is_moving() const {
    if (kind_ == Kind::rest) return false;
    if (kind_ == Kind::direct || kind_ == Kind::braking)
        return std::any_of(reference_.qd.begin(), reference_.qd.end(), [](double speed) { return speed != 0; });
    return true;
}

double Motion::queued_s() const {
    switch (kind_) {
        case Kind::timed: return timed_.remaining_s() + waiting_s_;
        case Kind::paced: return paced_.remaining_s(reference_.q) + waiting_s_;
        case Kind::line: return line_.duration_s - line_.elapsed_s + waiting_s_;
        default: return 0.0;
    }
}

bool Motion::begin(const Command& move) {
    const bool is_line = move.kind == CommandKind::move_line;
    const bool is_busy = kind_ == Kind::timed || kind_ == Kind::paced || kind_ == Kind::line;
    const bool is_replacing = !move.stops_at_point && queue_.empty() && !(stops_ && options_.queues_after_stop_point);
    const bool waits = is_busy && !is_replacing;
    const double duration_s = duration_of(move, waits ? goal_ : reference_.q);
    if (!is_line && move.tracking == Tracking::time && !waits && !is_feasible(move.q, duration_s)) return false;
    if (waits) {
        queue_.push_back({move, duration_s});
        waiting_s_ += duration_s;
        goal_ = is_line ? joints_of(line_goal(move), goal_) : move.q;
        return true;
    }
    return start({move, duration_s});
}

bool Motion::start(const Queued& queued) {
    const Command& move = queued.move;
    stops_ = move.stops_at_point;
    if (move.kind == CommandKind::move_line) {
        start_line(move, queued.duration_s);
        return true;
    }
    if (queue_.empty()) goal_ = move.q;
    if (move.tracking == Tracking::joint_speed && !move.stops_at_point) {
        paced_.begin(move.q, move.tracking_value, move.blend_s);
        kind_ = Kind::paced;
    } else {
        timed_.begin(reference_, move.q, queued.duration_s);
        kind_ = Kind::timed;
    }
    return true;
}

void Motion::start_line(const Command& move, double duration_s) {
    line_ = {forward(reference_.q), line_goal(move), duration_s, 0};
    kind_ = Kind::line;
    if (queue_.empty()) goal_ = joints_of(line_.to, reference_.q);
}

double Motion::duration_of(const Command& move, const Joints& from) const {
    if (move.tracking == Tracking::time) return move.tracking_value;
    if (move.kind == CommandKind::move_joints)
        return std::max(kTickS, distance(from, move.q) / move.tracking_value);
    const Frame begin = forward(from), end = line_goal(move);
    const double length = std::hypot(end.p[0] - begin.p[0], end.p[1] - begin.p[1], end.p[2] - begin.p[2]);
    const auto rotation = rotation_between(begin, end);
    const double angle = std::hypot(rotation[0], rotation[1], rotation[2]);
    return std::max({kTickS, length / move.tracking_value, angle / 1.0});  // KORD.ini's example turns by 1 rad/s
}

bool Motion::is_feasible(const Joints& goal, double duration_s) const {
    const bool from_rest = !kordsim::is_moving(reference_.qd);
    for (int joint = 0; joint < kJoints; ++joint) {
        const double mean = (goal[joint] - reference_.q[joint]) / duration_s;
        const double speed = from_rest ? kPeakSpeed * std::abs(mean) : std::abs(mean);
        const double acceleration = from_rest ? kPeakAcceleration * std::abs(mean) / duration_s
                                              : std::abs(mean - reference_.qd[joint]) / duration_s;
        if (speed > options_.qd_max_radps * kRounding || acceleration > options_.qdd_max_radps2 * kRounding)
            return false;
    }
    return true;
}

Joints Motion::expected() const {
    Joints next = reference_.q;
    for (int joint = 0; joint < kJoints; ++joint) next[joint] += reference_.qd[joint] * kTickS;
    return next;
}

void Motion::obey(const Command& direct) {
    queue_.clear();
    waiting_s_ = 0;
    kind_ = Kind::direct;
    goal_ = direct.q;
    ceased_ticks_ = 0;
    was_obeyed_ = true;
    move_to({direct.q, direct.qd});
}

bool Motion::advance() {
    switch (kind_) {
        case Kind::rest: acceleration_ = {}; return true;
        case Kind::timed: move_to(timed_.advance(kTickS)); return timed_.is_done() ? finish() : true;
        case Kind::paced: move_to(paced_.advance(reference_, kTickS)); return paced_.is_done() ? finish() : true;
        case Kind::line: return advance_line();
        case Kind::direct: advance_direct(); return true;
        case Kind::braking: slow_down(); return true;
    }
    return true;
}

bool Motion::advance_line() {
    line_.elapsed_s = std::min(line_.elapsed_s + kTickS, line_.duration_s);
    const double s = line_.elapsed_s / line_.duration_s;
    Reference next{reference_.q, {}};
    if (!solve(next.q, between(line_.from, line_.to, s * s * s * (10 - 15 * s + 6 * s * s)))) return false;
    if (s < 1)
        for (int joint = 0; joint < kJoints; ++joint) next.qd[joint] = (next.q[joint] - reference_.q[joint]) / kTickS;
    move_to(next);
    return s < 1 ? true : finish();
}

// A command that is missing is made up for once; when a second one is missing, the arm comes to rest.
void Motion::advance_direct() {
    if (was_obeyed_) {
        was_obeyed_ = false;
        return;
    }
    if (++ceased_ticks_ > 1)
        slow_down();
    else
        move_to({expected(), reference_.qd});
}

void Motion::slow_down() {
    const double change = options_.qdd_max_radps2 * kTickS;
    Reference next = reference_;
    for (int joint = 0; joint < kJoints; ++joint) {
        const double speed = reference_.qd[joint];
        next.qd[joint] = speed - std::clamp(speed, -change, change);
        next.q[joint] += next.qd[joint] * kTickS;
    }
    move_to(next);
    if (!is_moving()) goal_ = reference_.q;
}

void Motion::brake() {
    queue_.clear();
    waiting_s_ = 0;
    kind_ = Kind::braking;
}

void Motion::settle() {
    brake();
    kind_ = Kind::rest;
    reference_.qd = acceleration_ = {};
    goal_ = reference_.q;
}

void Motion::move_to(const Reference& next) {
    for (int joint = 0; joint < kJoints; ++joint)
        acceleration_[joint] = (next.qd[joint] - reference_.qd[joint]) / kTickS;
    reference_ = next;
}

// The end of one motion, and the beginning of the next that waits.
bool Motion::finish() {
    kind_ = Kind::rest;
    if (queue_.empty()) return true;
    const Queued next = queue_.front();
    queue_.pop_front();
    waiting_s_ = queue_.empty() ? 0.0 : waiting_s_ - next.duration_s;
    if (next.move.kind == CommandKind::move_joints && next.move.tracking == Tracking::time &&
        !is_feasible(next.move.q, next.duration_s))
        return false;
    return start(next);
}

}  // namespace kordsim
