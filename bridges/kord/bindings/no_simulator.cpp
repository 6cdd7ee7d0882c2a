// Of a build for real controllers: the same names, and an error that says where the simulator is.
#include <nanobind/stl/array.h>
#include <nanobind/stl/string.h>

#include "bindings.hpp"
#include "simulator.hpp"

namespace nb = nanobind;

namespace station_kord {

Hooks Simulator::hooks() const { return {}; }

namespace {

struct SimOptions {};

struct Server {};

[[noreturn]] void refuse() {
    throw Refusal("BadOption", "this build is for real controllers; the simulator is in a build without kord-api");
}

}  // namespace

void bind_simulator(nb::module_& module) {
    nb::class_<SimOptions>(module, "SimOptions", nb::dynamic_attr()).def(nb::init<>());
    nb::class_<Simulator>(module, "Simulator").def("__init__", [](Simulator*, const SimOptions&) { refuse(); });
    nb::class_<Server>(module, "Server")
        .def("__init__", [](Server*, const std::string&, const Simulator&, int) { refuse(); });
}

}  // namespace station_kord
