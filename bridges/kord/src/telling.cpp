// What the thread of a bridge tells of a tick: events, the state, a row of the trace.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "bridge.hpp"

namespace station_kord {

namespace {

constexpr uint32_t kKordGroup = 3, kHardwareGroup = 4;
constexpr uint32_t kHardwareCategory = 3;

uint32_t group_of(uint32_t alarm) {
    const uint32_t category = alarm & 0xf;
    if (category == kCbunCategory) return kKordGroup;
    return category == kHardwareCategory ? kHardwareGroup : category;
}

}  // namespace

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

void Bridge::publish() {
    const Reading& reading = session_.reading();
    const Counters& counters = motion_.counters();
    now_.mode = motion_.mode();
    now_.profile = profile_.name;
    now_.throttle = throttle();
    now_.is_moving = now_.is_connected && (arm().is_moving || motion_.is_under_way());
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

}  // namespace station_kord
