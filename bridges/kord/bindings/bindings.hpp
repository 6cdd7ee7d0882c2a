// One function per concept that Python sees.
#pragma once

#include <nanobind/nanobind.h>

namespace station_kord {

void bind_errors(nanobind::module_& module);
void bind_state(nanobind::module_& module);
void bind_simulator(nanobind::module_& module);
void bind_bridge(nanobind::module_& module);

}  // namespace station_kord
