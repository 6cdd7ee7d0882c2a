#include <nanobind/stl/array.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>

#include "bindings.hpp"
#include "plant.hpp"
#include "server.hpp"
#include "simulated_time.hpp"
#include "simulator.hpp"

namespace nb = nanobind;
using Free = nb::call_guard<nb::gil_scoped_release>;
using kordsim::Options;
using kordsim::Server;

namespace station_kord {

Hooks Simulator::hooks() const { return hooks_of(plant); }

namespace {

void bind_options(nb::module_& module) {
    nb::class_<Options>(module, "SimOptions")
        .def(nb::init<>())
        .def_rw("is_virtual", &Options::is_virtual)
        .def_rw("q_start", &Options::q_start)
        .def_rw("q_min", &Options::q_min)
        .def_rw("q_max", &Options::q_max)
        .def_rw("qd_max_radps", &Options::qd_max_radps)
        .def_rw("qdd_max_radps2", &Options::qdd_max_radps2)
        .def_rw("window_us", &Options::window_us)
        .def_rw("fetch_closes_window", &Options::fetch_closes_window)
        .def_rw("buffer_len", &Options::buffer_len)
        .def_rw("planner_time_ms", &Options::planner_time_ms)
        .def_rw("planner_speed_ms", &Options::planner_speed_ms)
        .def_rw("torque_deviation_rad", &Options::torque_deviation_rad)
        .def_rw("late_fault_ticks", &Options::late_fault_ticks)
        .def_rw("ack_ticks", &Options::ack_ticks)
        .def_rw("watchdog_ticks", &Options::watchdog_ticks)
        .def_rw("ceased_is_fault", &Options::ceased_is_fault)
        .def_rw("speed_noise_radps", &Options::speed_noise_radps)
        .def_rw("noise_seed", &Options::noise_seed)
        .def_rw("opaque", &Options::is_opaque)
        .def_rw("queues_after_stop_point", &Options::queues_after_stop_point);
}

nb::bytes trace_of(const Simulator& simulator, int64_t rows) {
    std::vector<kordsim::TraceRow> copied;
    {
        const nb::gil_scoped_release free;
        copied = simulator.plant->trace(rows);
    }
    return nb::bytes(reinterpret_cast<const char*>(copied.data()), copied.size() * sizeof(kordsim::TraceRow));
}

void start(Server& server, const std::string& path) {
    const std::string problem = server.start();
    if (!problem.empty()) throw Refusal("BadOption", "socket " + path + ": " + problem);
}

// A server, and its path for what it has to say.
struct NamedServer {
    NamedServer(const std::string& path_, const Simulator& simulator, int priority)
        : path(path_), server(path_, simulator.plant, priority) {}
    std::string path;
    Server server;
};

}  // namespace

void bind_simulator(nb::module_& module) {
    bind_options(module);
    nb::class_<Simulator>(module, "Simulator")
        .def("__init__",
             [](Simulator* self, const Options& options) {
                 auto plant = std::make_shared<kordsim::Plant>(options);
                 new (self) Simulator{plant, kordsim::enroll(plant)};
             })
        .def("delay_commands", [](Simulator& self, int count) { self.plant->delay_commands(count); }, Free())
        .def("fail_sends", [](Simulator& self, int count) { self.plant->fail_sends(count); }, Free())
        .def("lose_commands", [](Simulator& self, int count) { self.plant->lose_commands(count); }, Free())
        .def("pause", [](Simulator& self, bool paused) { self.plant->pause(paused); }, Free())
        .def("emergency_stop", [](Simulator& self, bool pressed) { self.plant->emergency_stop(pressed); }, Free())
        .def("confirm", [](Simulator& self) { self.plant->confirm(); }, Free())
        .def("raise_event", [](Simulator& self, uint32_t condition) { self.plant->raise_event(condition); }, Free())
        .def("silence", [](Simulator& self, bool silent) { self.plant->silence(silent); }, Free())
        .def("tick", [](Simulator& self) { return self.plant->ticks(); }, Free())
        .def("is_moving", [](Simulator& self) { return self.plant->is_moving(); }, Free())
        .def("trace", &trace_of);
    nb::class_<NamedServer>(module, "Server")
        .def(nb::init<const std::string&, const Simulator&, int>())
        .def("start", [](NamedServer& self) { start(self.server, self.path); }, Free())
        .def("stop", [](NamedServer& self) { self.server.stop(); }, Free())
        .def("has_client", [](NamedServer& self) { return self.server.has_client(); });
}

}  // namespace station_kord
