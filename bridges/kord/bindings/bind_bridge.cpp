#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>

#include <cstring>

#include "bindings.hpp"
#include "bridge.hpp"
#include "simulator.hpp"

namespace nb = nanobind;
using namespace nb::literals;
using Free = nb::call_guard<nb::gil_scoped_release>;

namespace station_kord {

namespace {

void set_name(Profile& profile, const std::string& name) {
    profile.name.fill(0);
    std::memcpy(profile.name.data(), name.data(), std::min(name.size(), profile.name.size() - 1));
}

void bind_profile(nb::module_& module) {
    nb::class_<Profile>(module, "Profile")
        .def(nb::init<>())
        .def_prop_rw("name", [](const Profile& self) { return std::string(self.name.data()); }, &set_name)
        .def_rw("tracks_time", &Profile::tracks_time)
        .def_rw("tracking_value", &Profile::tracking_value)
        .def_rw("blends", &Profile::blends)
        .def_rw("blend_s", &Profile::blend_s)
        .def_rw("stops_at_points", &Profile::stops_at_points)
        .def_rw("throttle", &Profile::throttle)
        .def_rw("offset_guard", &Profile::offset_guard)
        .def_rw("guard_qdd_radps2", &Profile::guard_qdd_radps2)
        .def_rw("sim_only", &Profile::sim_only);
}

void bind_config(nb::module_& module) {
    nb::class_<BridgeConfig>(module, "BridgeConfig")
        .def(nb::init<>())
        .def_rw("host", &BridgeConfig::host)
        .def_rw("port", &BridgeConfig::port)
        .def_rw("session_id", &BridgeConfig::session_id)
        .def_rw("q_min", &BridgeConfig::q_min)
        .def_rw("q_max", &BridgeConfig::q_max)
        .def_rw("qd_max", &BridgeConfig::qd_max)
        .def_rw("qdd_max", &BridgeConfig::qdd_max)
        .def_rw("profile", &BridgeConfig::profile)
        .def_rw("is_simulated", &BridgeConfig::is_simulated)
        .def_rw("fetch_first", &BridgeConfig::fetch_first)
        .def_rw("resend_targets", &BridgeConfig::resend_targets)
        .def_rw("real_time_priority", &BridgeConfig::real_time_priority)
        .def_rw("lock_memory", &BridgeConfig::lock_memory)
        .def_rw("trace_ticks", &BridgeConfig::trace_ticks);
}

nb::bytes trace_of(const Bridge& bridge, int64_t rows) {
    std::vector<TraceRow> copied;
    {
        const nb::gil_scoped_release free;
        copied = bridge.trace(rows);
    }
    return nb::bytes(reinterpret_cast<const char*>(copied.data()), copied.size() * sizeof(TraceRow));
}

void construct(Bridge* self, BridgeConfig config, const Simulator* simulator) {
    Hooks hooks;
    if (simulator != nullptr) {
        config.host = simulator->name;
        hooks = simulator->hooks();
    }
    new (self) Bridge(std::move(config), std::move(hooks));
}

}  // namespace

void bind_bridge(nb::module_& module) {
    bind_profile(module);
    bind_config(module);
    nb::class_<Bridge>(module, "Bridge")
        .def("__init__", &construct, "config"_a, "simulator"_a.none())
        .def("connect", &Bridge::connect, Free())
        .def("close", &Bridge::close, Free())
        .def("state", &Bridge::state, Free())
        .def("real_time", &Bridge::real_time)
        .def("trace", &trace_of)
        .def("step", &Bridge::step, Free())
        .def("engage", &Bridge::engage, Free())
        .def("disengage", &Bridge::disengage)
        .def("hold", &Bridge::hold, Free())
        .def("stream_j", &Bridge::stream_j, Free())
        .def("velocity_j", &Bridge::velocity_j, Free())
        .def("direct_j", &Bridge::direct_j, Free())
        .def("move_j", &Bridge::move_j, Free())
        .def("move_l", &Bridge::move_l, Free())
        .def("set_profile", &Bridge::set_profile, Free())
        .def("set_throttle", &Bridge::set_throttle)
        .def("clear_faults", &Bridge::clear_faults, Free());
}

}  // namespace station_kord
