// The thread of a bridge: waitSync, the command, fetchData, once per tick and in this order.
#include <algorithm>
#include <cmath>
#include <ctime>

#include "bridge.hpp"

namespace station_kord {

namespace {

constexpr double kStandstillRadps = 1e-3;
constexpr int kSilentWaits = 12;         // 100 ms without a heartbeat: the session is lost
constexpr int kFirstWaits = 125;         // one second for the first heartbeat
constexpr int kWindDownTicks = 600;      // 2.4 s: the longest stop of a move, twice, and some
constexpr int64_t kPercentileTicks = 50;
constexpr double kMissShare = 0.4;       // of a tick that a heartbeat may be late without one being missed
constexpr double kWindowUs = 1500;       // a command after it acts one tick later; for controllers that do not tell
constexpr uint32_t kConnectionGroup = 5;

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
    revoke(granted_.load());  // of the session before
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
    const bool is_back = !now_.is_connected;  // what is known of the arm is of before
    now_.is_connected = true;

    if (config_.fetch_first) read();
    follow_engagement();
    const int64_t sent = sends();
    recover();
    if (!recovery_.is_working() && !is_back) act(arm());
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
// wrote it has been granted the engagement before. A profile waits until the arm stands, whatever came meanwhile.
void Bridge::follow_engagement() {
    const bool is_new = wishes_.refresh();
    const Reading& reading = session_.reading();
    const bool is_open = !reading.is_stopped() && reading.is_ready();
    const bool takes_commands = now_.is_connected && is_open && !recovery_.is_working() && !is_stopping_;
    const uint64_t granted = granted_.load();
    // It may have been asked for in the very tick in which the arm began to move, by who could not see that yet.
    const bool is_early = granted != epoch_ && (arm().is_moving || motion_.is_under_way());
    if (!takes_commands || is_early) revoke(granted);
    const bool is_engaged = granted > revoked_.load();
    if (!is_open || (is_engaged && granted != epoch_)) {
        motion_.reset(reading.q);
    } else if (!now_.is_connected) {
        motion_.lose(arm());
    } else if (!is_engaged && epoch_ != 0) {
        motion_.hold(arm());
    }
    if (!arm().is_moving && !motion_.is_pending() && profiles_.refresh()) profile_ = profiles_.front();
    epoch_ = is_engaged ? granted : 0;
    if (is_new && is_engaged && wishes_.front().epoch == epoch_) motion_.take(wishes_.front(), arm());
}

Arm Bridge::arm() const {
    const Reading& reading = session_.reading();
    const bool is_fast = std::any_of(reading.qd.begin(), reading.qd.end(),
                                     [](double speed) { return std::abs(speed) > kStandstillRadps; });
    const bool is_queued = reading.has_insight && reading.insight.queued_motion_s > 0;
    return {reading.q, reading.qd, is_fast || is_queued || ticks_since_send_ < kBeginTicks, passed_ticks_,
            reading.tcp};
}

void Bridge::act(const Arm& arm) {
    const Sending sending = motion_.decide(arm, profile_, throttle());
    if (sending.kind == Mode::idle) return;
    if (session_.reading().is_stopped() || !send(sending)) return motion_.unsent();
    const double took_us = static_cast<double>(monotonic_ns() - returned_ns_) * 1e-3;
    sync_to_send_.add(took_us);
    if (!session_.reading().has_insight && took_us > kWindowUs) ++now_.late_commands;
    ticks_since_send_ = 0;
}

bool Bridge::send(const Sending& sending) {
    if (!hand_over(sending)) {
        ++now_.failed_sends;
        return false;
    }
    const bool is_pose = sending.kind == Mode::move_line && sending.stop_s == 0;
    if (!is_pose) now_.q_sent = sending.q;
    const bool is_stream = sending.kind == Mode::stream, is_direct = sending.kind == Mode::direct;
    ++(is_stream ? now_.stream_j_sends : is_direct ? now_.direct_sends : now_.move_sends);
    return true;
}

bool Bridge::hand_over(const Sending& sending) {
    if (sending.stop_s > 0) return session_.stop(sending.q, sending.stop_s);
    switch (sending.kind) {
        case Mode::stream: return session_.stream(sending.q, profile_);
        case Mode::velocity:  // sent as direct commands
        case Mode::direct: return session_.direct(sending.q, sending.qd, sending.qdd);
        case Mode::move_joints: return session_.move_joints(sending.q, sending.speed);
        case Mode::move_line: return session_.move_line(sending.pose, sending.speed);
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
    if (is_stopped) revoke(granted_.load());
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

// A speed is brought to zero and a move is stopped before the session ends; what is near of a stream the controller
// finishes by itself.
bool Bridge::winds_down() {
    const bool is_driven = epoch_ != 0 || (now_.mode != Mode::idle && now_.mode != Mode::stream);
    return is_driven && now_.is_connected && !now_.is_faulted && ++wind_down_ticks_ < kWindDownTicks;
}

}  // namespace station_kord
