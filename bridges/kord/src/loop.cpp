// The thread of a bridge: waitSync, the command, fetchData, once per tick and in this order.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <ctime>

#include "bridge.hpp"

namespace station_kord {

namespace {

constexpr double kStandstillRadps = 1e-3;
constexpr int64_t kBeginTicks = 5;       // until a command that was sent can be seen in the arm's speed
constexpr int kSilentWaits = 12;         // 100 ms without a heartbeat: the session is lost
constexpr int kFirstWaits = 125;         // one second for the first heartbeat
constexpr int kWindDownTicks = 60;
constexpr int64_t kPercentileTicks = 50;
constexpr double kMissShare = 0.4;       // of a tick that a heartbeat may be late without one being missed
constexpr double kWindowUs = 1500;       // a command after it acts one tick later; for controllers that do not tell
constexpr uint32_t kKordGroup = 3, kHardwareGroup = 4, kConnectionGroup = 5;
constexpr uint32_t kHardwareCategory = 3, kCbun = 4;

uint32_t group_of(uint32_t alarm) {
    const uint32_t category = alarm & 0xf;
    if (category == kCbun) return kKordGroup;
    return category == kHardwareCategory ? kHardwareGroup : category;
}

}  // namespace

void Bridge::be_punctual() {
    const std::string refusal = config_.real_time_priority > 0 ? request_fifo(config_.real_time_priority) : "";
    const int priority = fifo_priority();
    now_.sched_fifo_granted = priority > 0;
    std::string obtained = priority > 0 ? "SCHED_FIFO " + std::to_string(priority) : "normal scheduling";
    if (!refusal.empty()) obtained += " (" + refusal + ")";
    if (config_.lock_memory) {
        const std::string reason = memory_.acquire();
        now_.memory_locked = reason.empty();
        obtained += reason.empty() ? ", memory locked" : ", memory not locked (" + reason + ")";
    }
    const std::lock_guard lock(report_mutex_);
    real_time_ = obtained;
}

void Bridge::run() {
    be_punctual();
    try {
        const bool is_open = open();
        report(is_open ? "" : "it is silent");
        while (is_open && (!is_stopping_ || winds_down())) tick();
        session_.close();
    } catch (const std::exception& error) {  // kord-api's, when it cannot make a socket
        report(error.what());
        note(0, kConnectionGroup);
        note_fault(true);
    }
    memory_.release();
    now_.is_connected = now_.memory_locked = false;
    publish();
    is_running_ = false;
}

bool Bridge::open() {
    heard_ns_ = 0;
    silent_waits_ = wind_down_ticks_ = 0;
    ticks_since_send_ = kBeginTicks;
    epoch_ = 0;
    if (!session_.open(config_)) return false;
    opened_ns_ = now_ns();
    late_seen_ = session_.reading().insight.late_commands;
    motion_.reset(session_.reading().q);
    now_.is_connected = true;
    now_.mono_ns = opened_ns_;
    now_.q_sent = session_.reading().q;
    read();
    publish();
    if (hooks_.step) return true;
    const int64_t before = now_.tick;
    for (int wait = 0; wait < kFirstWaits && now_.tick == before && !is_stopping_; ++wait) tick();
    return now_.tick > before;
}

void Bridge::report(const std::string& problem) {
    const std::lock_guard lock(report_mutex_);
    has_reported_ = true;
    problem_ = problem;
    reported_.notify_all();
}

void Bridge::tick() {
    if (!session_.wait()) return lost_tick();
    returned_ns_ = monotonic_ns();
    const int64_t heard_ns = now_ns(), since_ns = heard_ns_ > 0 ? heard_ns - heard_ns_ : kTickNs;
    passed_ticks_ = std::max<int64_t>(1, static_cast<int64_t>(static_cast<double>(since_ns) / kTickNs + kMissShare));
    if (heard_ns_ > 0) period_.add(static_cast<double>(since_ns) * 1e-3);
    heard_ns_ = now_.mono_ns = heard_ns;
    now_.missed_ticks += passed_ticks_ - 1;
    ++now_.tick;
    ticks_since_send_ += passed_ticks_;
    silent_waits_ = 0;
    now_.is_connected = true;

    if (config_.fetch_first) read();
    follow_engagement();
    const int64_t sent = sends();
    recover();
    if (!recovery_.is_working()) act(arm());
    if (!config_.fetch_first) read();

    if (now_.tick % kPercentileTicks == 0) {
        sync_to_send_.update();
        period_.update();
    }
    publish();
    remember(sends() != sent);
}

void Bridge::lost_tick() {
    ++now_.sync_timeouts;
    ++ticks_since_send_;
    if (++silent_waits_ >= kSilentWaits && now_.is_connected) lose();
    follow_engagement();
    recover();
    publish();
    if (config_.is_simulated || monotonic_ns() - returned_ns_ > kTickNs) {
        returned_ns_ = monotonic_ns();
        return;
    }
    const timespec tick{0, kTickNs};  // a library that gives up at once must not make the loop run away
    nanosleep(&tick, nullptr);
}

// Only the newest wish counts, and only if it belongs to the engagement that holds. The wish is looked at first: whoever
// wrote it has been granted the engagement before.
void Bridge::follow_engagement() {
    const bool is_new = wishes_.refresh();
    if (profiles_.refresh()) profile_ = profiles_.front();
    const bool is_stopped = session_.reading().is_stopped() || !now_.is_connected;
    if (is_stopped || !session_.reading().is_ready()) revoked_ = granted_.load();
    const uint64_t granted = granted_.load();
    const bool is_engaged = granted > revoked_.load();
    if (is_stopped) {
        motion_.reset(session_.reading().q);
    } else if (is_engaged && granted != epoch_) {
        motion_.reset(session_.reading().q);
    } else if (!is_engaged && epoch_ != 0) {
        motion_.take(Wish{}, arm());
    }
    epoch_ = is_engaged ? granted : 0;
    if (is_new && is_engaged && wishes_.front().epoch == epoch_) motion_.take(wishes_.front(), arm());
}

Arm Bridge::arm() const {
    const Reading& reading = session_.reading();
    const bool is_fast = std::any_of(reading.qd.begin(), reading.qd.end(),
                                     [](double speed) { return std::abs(speed) > kStandstillRadps; });
    const bool is_queued = reading.has_insight && reading.insight.queued_motion_s > 0;
    return {reading.q, reading.qd, is_fast || is_queued || ticks_since_send_ < kBeginTicks, passed_ticks_};
}

void Bridge::act(const Arm& arm) {
    const Sending sending = motion_.decide(arm, profile_, throttle_.load(std::memory_order_relaxed));
    if (sending.kind == Mode::idle || session_.reading().is_stopped() || !send(sending)) return;
    const double took_us = static_cast<double>(monotonic_ns() - returned_ns_) * 1e-3;
    sync_to_send_.add(took_us);
    if (!session_.reading().has_insight && took_us > kWindowUs) ++now_.late_commands;
    ticks_since_send_ = 0;
}

bool Bridge::send(const Sending& sending) {
    switch (sending.kind) {
        case Mode::stream:
            now_.q_sent = sending.q;
            return session_.stream(sending.q, profile_) && ++now_.stream_j_sends;
        case Mode::velocity:
        case Mode::direct:
            now_.q_sent = sending.q;
            return session_.direct(sending.q, sending.qd, sending.qdd) && ++now_.direct_sends;
        case Mode::move_joints:
            now_.q_sent = sending.q;
            return session_.move_joints(sending.q, sending.speed) && ++now_.move_sends;
        case Mode::move_line: return session_.move_line(sending.pose, sending.speed) && ++now_.move_sends;
        case Mode::idle: break;
    }
    return false;
}

void Bridge::read() {
    session_.fetch();
    const Reading& reading = session_.reading();
    if (reading.has_insight) {
        now_.late_commands += std::max<int64_t>(0, reading.insight.late_commands - late_seen_);
        late_seen_ = reading.insight.late_commands;
    }
    if (reading.alarm != now_.alarm_state || reading.is_stopped() != now_.is_faulted) note_events();
    note_fault(reading.is_stopped());
    now_.motion_flags = reading.motion_flags;
    now_.safety_flags = reading.safety_flags;
    now_.alarm_state = reading.alarm;
}

void Bridge::note_fault(bool is_stopped) {
    if (is_stopped && !now_.is_faulted) ++now_.fault_count;
    now_.is_faulted = is_stopped;
    if (is_stopped) revoked_ = granted_.load();
}

// The library's list allocates, so it is asked for only when something has changed: by then the arm is stopped.
void Bridge::note_events() {
    const Reading& reading = session_.reading();
    if (!reading.is_stopped()) return;
    const auto told = session_.events();
    for (const auto& event : told) note(event.event_id_, event.event_group_);
    if (told.empty() && reading.alarm != 0) note(reading.alarm >> 8 & 0xfff, group_of(reading.alarm));
}

void Bridge::note(uint32_t id, uint32_t group) {
    if (now_.event_count == kEvents) {
        std::move(now_.events.begin() + 1, now_.events.end(), now_.events.begin());
        --now_.event_count;
    }
    const int64_t number = now_.event_count > 0 ? now_.events[static_cast<size_t>(now_.event_count - 1)].number : 0;
    now_.events[static_cast<size_t>(now_.event_count++)] = {number + 1, now_.tick, now_.mono_ns, id, group};
}

void Bridge::lose() {
    now_.is_connected = false;
    note(0, kConnectionGroup);
    note_fault(true);
}

void Bridge::recover() {
    const int64_t asked = recovery_ticks_.exchange(0);
    if (asked > 0) recovery_.begin(asked);
    if (!recovery_.is_working()) return;
    recovery_.work(session_, now_.is_connected);
    if (recovery_.is_working()) return;
    recovery_outcome_ = recovery_.outcome();
    ++recovery_number_;
}

void Bridge::publish() {
    const Reading& reading = session_.reading();
    const Counters& counters = motion_.counters();
    now_.mode = motion_.mode();
    now_.profile = profile_.name;
    now_.throttle = throttle_;
    now_.is_moving = now_.is_connected && arm().is_moving;
    now_.needs_user_confirmation = reading.needs_user();
    now_.session_age_s = static_cast<double>(now_ns() - opened_ns_) * 1e-9;
    now_.q = reading.q;
    now_.qd = reading.qd;
    now_.qdd = reading.qdd;
    now_.torque = reading.torque;
    now_.tcp_pose = reading.tcp;
    now_.q_target = motion_.target();
    now_.safety_mode = reading.safety_mode;
    now_.master_speed = reading.master_speed;
    now_.queued_motion_s = reading.has_insight ? reading.insight.queued_motion_s : std::nan("");
    now_.planner_backlog = reading.has_insight ? reading.insight.planner_backlog : -1;
    now_.commands_dropped_by_throttle = counters.dropped;
    now_.slewed_sends = counters.slewed;
    now_.limit_refusals = counters.refused;
    now_.sync_to_send_us = sync_to_send_.timing();
    now_.period_us = period_.timing();
    told_.write(now_);
}

void Bridge::remember(bool was_sent) {
    TraceRow row;
    row.tick = now_.tick;
    std::memcpy(row.q, now_.q.data(), sizeof row.q);
    std::memcpy(row.qd, now_.qd.data(), sizeof row.qd);
    std::memcpy(row.q_target, now_.q_target.data(), sizeof row.q_target);
    std::memcpy(row.q_sent, now_.q_sent.data(), sizeof row.q_sent);
    row.queued_motion_s = now_.queued_motion_s;
    row.planner_backlog = now_.planner_backlog;
    row.sent = was_sent;
    row.late = now_.late_commands > late_traced_;
    late_traced_ = now_.late_commands;
    row.moving = now_.is_moving;
    row.fault = now_.is_faulted;
    if (!trace_.push(row)) ++now_.trace_skipped;
}

// A speed is brought to zero before the session ends; what the controller has of a stream it finishes by itself.
bool Bridge::winds_down() {
    const bool is_driven = now_.mode == Mode::velocity || now_.mode == Mode::direct;
    return is_driven && now_.is_connected && !now_.is_faulted && ++wind_down_ticks_ < kWindDownTicks;
}

}  // namespace station_kord
