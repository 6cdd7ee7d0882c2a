#include "controller.hpp"

#include <algorithm>
#include <cmath>

namespace kordsim {

namespace {

constexpr uint32_t kEstopCondition = 1001, kTorqueDeviation = 1010, kTooFast = 2002, kOutOfRange = 2005;
constexpr uint32_t kBadConnection = 3001, kInfeasible = 3002;
constexpr uint32_t kEstopContext = 1, kSstopContext = 4;
constexpr int8_t kAccepted = 0, kRefused = 2;
constexpr int64_t kFollowTicks = 4;    // 16 ms: the slowest of the vendor's patterns for streams
constexpr double kCeasedSpanRad = 1e-6;  // a tick; on_movej_cmd_ceased_span in KORD.ini's example
constexpr size_t kRoom = 64;  // commands in flight; a session sends one per tick

uint32_t category_of(uint32_t condition) {
    if (condition >= 3000) return kCbunCategory;
    if (condition >= 2000) return kSoftStopCategory;
    return condition >= 1000 ? kSafetyCategory : kHardwareCategory;
}

uint32_t group_of(uint32_t condition) { return condition >= 3000 ? 3u : condition / 1000; }

}  // namespace

Controller::Controller(const Options& options) : options_(options), planner_(options_), motion_(options_) {
    pending_.reserve(kRoom);
    due_direct_.reserve(kRoom);
    clearing_.reserve(kRoom);
    status_.is_opaque = options_.is_opaque;
    publish(0);
}

void Controller::open() {
    has_session_ = true;
    status_.is_lost = 0;
    ticks_since_wait_ = late_streak_ = 0;
}

void Controller::close() {
    has_session_ = false;
    pending_.clear();
}

void Controller::waited() { ticks_since_wait_ = 0; }

void Controller::receive(const Command& command) {
    if (status_.is_lost || pending_.size() == kRoom) return;
    if (losing_ > 0) {
        --losing_;
        return;
    }
    ++received_;
    if (!takes_commands()) return;  // "sent" is all that its sender hears
    const bool late = is_late(command);
    late_streak_ = late ? late_streak_ + 1 : 0;
    status_.late_commands += late;
    late_this_tick_ |= late;
    pending_.push_back({command, tick_ + (late ? 2 : 1)});
    if (late_streak_ >= options_.late_fault_ticks && is_moving(motion_.reference().qd)) fault(kTorqueDeviation);
}

void Controller::receive(const Clear& clear) {
    if (clearing_.size() < kRoom) clearing_.push_back({clear, tick_ + options_.ack_ticks});
}

bool Controller::is_late(const Command& command) {
    if (delayed_ > 0) {
        --delayed_;
        return true;
    }
    const bool is_closed = options_.fetch_closes_window && command.was_fetched;
    return is_closed || command.offset_us > options_.window_us || tick_ > command.tick + 1;
}

void Controller::tick(int64_t time_ns) {
    ++tick_;
    ++ticks_since_wait_;
    ++ticks_since_move_;
    received_ = 0;
    late_this_tick_ = false;
    for (size_t i = 0; i < clearing_.size();) {
        if (clearing_[i].due > tick_) {
            ++i;
            continue;
        }
        acknowledge(clearing_[i].request);
        clearing_.erase(clearing_.begin() + static_cast<std::ptrdiff_t>(i));
    }
    take_due();
    if (!motion_.advance() && !is_stopped()) fault(kInfeasible);
    watch();
    publish(time_ns);
}

void Controller::take_due() {
    due_direct_.clear();
    for (size_t i = 0; i < pending_.size();) {
        if (pending_[i].due > tick_) {
            ++i;
            continue;
        }
        const Command command = pending_[i].command;
        pending_.erase(pending_.begin() + static_cast<std::ptrdiff_t>(i));
        if (is_stopped()) continue;
        if (command.kind == CommandKind::direct)
            due_direct_.push_back(command);
        else if (command.kind == CommandKind::move_joints && !is_within_limits(command.q))
            fault(kOutOfRange);
        else if (command.tracking == Tracking::joint_speed && command.tracking_value > options_.qd_max_radps)
            fault(kTooFast);
        else if (!planner_.accept(command))
            fault(kBadConnection);
        else if (!motion_.begin(command))
            fault(kInfeasible);
        else
            ticks_since_move_ = 0;
    }
    planner_.pass();
    take_direct(due_direct_);
}

void Controller::take_direct(const std::vector<Command>& due) {
    if (due.empty() || is_stopped()) return;
    const Joints expected = motion_.is_direct() ? motion_.expected() : motion_.reference().q;
    const bool may_begin = motion_.is_direct() || !motion_.is_moving();
    for (const Command& command : due) {
        if (!may_begin || distance(command.q, expected) > options_.torque_deviation_rad) return fault(kTorqueDeviation);
        if (!is_within_limits(command.q)) return fault(kOutOfRange);
    }
    planner_.clear();
    motion_.obey(due.back());
}

bool Controller::is_within_limits(const Joints& q) const {
    for (int joint = 0; joint < kJoints; ++joint)
        if (!(q[joint] >= options_.q_min[joint] && q[joint] <= options_.q_max[joint])) return false;
    return true;
}

void Controller::watch() {
    if (is_stopped()) return;
    const Joints& qd = motion_.reference().qd;
    if (std::any_of(qd.begin(), qd.end(), [&](double v) { return std::abs(v) > options_.qd_max_radps * 1.001; }))
        fault(kTooFast);
    else if (motion_.is_moving() && ticks_since_wait_ >= options_.watchdog_ticks)
        fault(kBadConnection);
    else if (options_.ceased_is_fault && have_commands_ceased())
        fault(kBadConnection);
}

// Direct ones, and targets that were to be followed by others, while the arm still moves.
bool Controller::have_commands_ceased() const {
    const Joints& qd = motion_.reference().qd;
    if (motion_.is_direct()) return motion_.ceased_ticks() > 1 && is_moving(qd);
    const bool moves_on =
        std::any_of(qd.begin(), qd.end(), [](double v) { return std::abs(v) * kTickS > kCeasedSpanRad; });
    return motion_.is_to_be_followed() && ticks_since_move_ > kFollowTicks && moves_on;
}

void Controller::fault(uint32_t condition) {
    if (status_.alarm != 0) return;
    const bool is_estop = condition == kEstopCondition;
    status_.motion_flags |= kSuspended | (condition == kTorqueDeviation || is_estop ? kHalt : 0u);
    status_.safety_flags |= is_estop ? kEstop | kUserConfirmation : kSstop;
    status_.alarm = category_of(condition) | (is_estop ? kEstopContext : kSstopContext) << 4 | condition << 8;
    has_cbun_event_ = category_of(condition) == kCbunCategory;
    if (condition == kInfeasible) status_.is_lost = 1;
    if (group_of(condition) > 0) tell(condition, group_of(condition));
    planner_.clear();
    pending_.clear();
    late_streak_ = 0;
    motion_.brake();
}

void Controller::press_emergency_stop(bool is_pressed) {
    is_pressed_ = is_pressed;
    if (!is_pressed) return;
    fault(kEstopCondition);
    status_.motion_flags |= kHalt | kSuspended;
    status_.safety_flags |= kEstop | kUserConfirmation;
    status_.alarm |= kEstopContext << 4;
}

void Controller::confirm() {
    if (!is_pressed_) status_.safety_flags &= ~(kUserConfirmation | kEstop);
}

// By a person at the pendant: nothing is wrong, and nothing is taken from afar.
void Controller::pause(bool is_paused) {
    if (is_paused) {
        status_.motion_flags |= kPaused;
        planner_.clear();
        pending_.clear();
        motion_.brake();
    } else if (status_.motion_flags & kPaused) {
        status_.motion_flags &= ~kPaused;
        if (!is_stopped()) motion_.settle();
    }
}

void Controller::acknowledge(const Clear& request) {
    auto& slot = status_.acknowledged[static_cast<size_t>(acknowledged_next_)];
    acknowledged_next_ = (acknowledged_next_ + 1) % kAcknowledged;
    slot = {request.token, clear(request.what)};
}

int8_t Controller::clear(int32_t what) {
    if (status_.safety_flags & kUserConfirmation) return kRefused;
    if (what == 0) status_.motion_flags &= ~kHalt;
    if (what == 1) {
        status_.motion_flags &= ~kSuspended;
        status_.safety_flags &= ~kSstop;
    }
    if (what == 4) {
        if (!has_cbun_event_) return kRefused;
        has_cbun_event_ = false;
    }
    resume_if_clear();
    return kAccepted;
}

void Controller::resume_if_clear() {
    const bool is_broken = (status_.alarm & 0xf) == kHardwareCategory;  // no request mends that
    if ((status_.motion_flags & (kHalt | kSuspended)) != 0 || has_cbun_event_ || is_broken) return;
    status_.alarm = 0;
    planner_.clear();
    pending_.clear();
    motion_.settle();
}

void Controller::tell(uint32_t condition, uint32_t group) {
    const int slot = std::min(status_.event_count, kToldEvents - 1);
    status_.events[static_cast<size_t>(slot)] = {status_.time_ns, condition, group};
    status_.event_count = slot + 1;
}

void Controller::publish(int64_t time_ns) {
    status_.tick = tick_;
    status_.time_ns = time_ns;
    status_.q = motion_.reference().q;
    status_.qd = motion_.reference().qd;
    status_.qdd = motion_.acceleration();
    for (size_t joint = 0; joint < kJoints; ++joint)  // links of some kilograms, and the friction of the public model
        status_.torque[joint] = 0.5 * status_.qdd[joint] + 0.1 * status_.qd[joint];
    status_.tcp = to_pose(forward(status_.q));
    status_.queued_motion_s = motion_.queued_s();
    status_.planner_backlog = planner_.backlog();
    status_.motion_flags &= ~(kStandby | kTracking);
    if (motion_.is_moving()) status_.motion_flags |= kTracking;
    else if (!is_stopped()) status_.motion_flags |= kStandby;
}

}  // namespace kordsim
