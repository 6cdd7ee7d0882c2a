#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "bindings.hpp"
#include "events.hpp"
#include "types.hpp"

namespace nb = nanobind;

namespace station_kord {

namespace {

const char* mode_name(Mode mode) {
    constexpr const char* kNames[] = {"idle", "stream", "velocity", "direct", "move-joints", "move-line"};
    return kNames[static_cast<int>(mode)];
}

std::vector<Event> events_of(const State& state) {
    return {state.events.begin(), state.events.begin() + state.event_count};
}

void bind_parts(nb::module_& module) {
    nb::class_<Timing>(module, "Timing")
        .def_ro("last", &Timing::last)
        .def_ro("p50", &Timing::p50)
        .def_ro("p99", &Timing::p99)
        .def_ro("max", &Timing::max);
    nb::class_<Event>(module, "Event")
        .def_ro("number", &Event::number)
        .def_ro("id", &Event::id)
        .def_prop_ro("group", [](const Event& event) { return std::string(group_name(event.group)); })
        .def_prop_ro("text", [](const Event& event) { return std::string(event_text(event.id)); })
        .def_ro("tick", &Event::tick)
        .def_ro("mono_ns", &Event::mono_ns);
}

void bind_arm(nb::class_<State>& state) {
    state.def_ro("q", &State::q)
        .def_ro("qd", &State::qd)
        .def_ro("qdd", &State::qdd)
        .def_ro("torque", &State::torque)
        .def_ro("tcp_pose", &State::tcp_pose)
        .def_ro("q_target", &State::q_target)
        .def_ro("q_sent", &State::q_sent)
        .def_ro("queued_motion_s", &State::queued_motion_s)
        .def_ro("planner_backlog", &State::planner_backlog)
        .def_ro("motion_flags", &State::motion_flags)
        .def_ro("safety_flags", &State::safety_flags)
        .def_ro("safety_mode", &State::safety_mode)
        .def_ro("master_speed", &State::master_speed)
        .def_ro("alarm_state", &State::alarm_state)
        .def_prop_ro("events", events_of);
}

void bind_session(nb::class_<State>& state) {
    state.def_prop_ro("mode", [](const State& told) { return std::string(mode_name(told.mode)); })
        .def_prop_ro("profile", [](const State& told) { return std::string(told.profile.data()); })
        .def_ro("throttle", &State::throttle)
        .def_ro("is_connected", &State::is_connected)
        .def_ro("is_engaged", &State::is_engaged)
        .def_ro("is_faulted", &State::is_faulted)
        .def_ro("is_moving", &State::is_moving)
        .def_prop_ro("not_ready", [](const State& told) { return not_ready_text(told.motion_flags); })
        .def_ro("needs_user_confirmation", &State::needs_user_confirmation)
        .def_ro("sched_fifo_granted", &State::sched_fifo_granted)
        .def_ro("memory_locked", &State::memory_locked)
        .def_ro("mono_ns", &State::mono_ns)
        .def_ro("session_age_s", &State::session_age_s);
}

void bind_counters(nb::class_<State>& state) {
    state.def_ro("tick", &State::tick)
        .def_ro("stream_j_sends", &State::stream_j_sends)
        .def_ro("direct_sends", &State::direct_sends)
        .def_ro("move_sends", &State::move_sends)
        .def_ro("failed_sends", &State::failed_sends)
        .def_ro("commands_dropped_by_throttle", &State::commands_dropped_by_throttle)
        .def_ro("slewed_sends", &State::slewed_sends)
        .def_ro("limit_refusals", &State::limit_refusals)
        .def_ro("sync_timeouts", &State::sync_timeouts)
        .def_ro("missed_ticks", &State::missed_ticks)
        .def_ro("late_commands", &State::late_commands)
        .def_ro("fault_count", &State::fault_count)
        .def_ro("trace_skipped", &State::trace_skipped)
        .def_ro("sync_to_send_us", &State::sync_to_send_us)
        .def_ro("period_us", &State::period_us);
}

}  // namespace

void bind_state(nb::module_& module) {
    bind_parts(module);
    nb::class_<State> state(module, "State");
    bind_arm(state);
    bind_session(state);
    bind_counters(state);
}

}  // namespace station_kord
