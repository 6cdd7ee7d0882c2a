#include "bindings.hpp"

#include "backend.hpp"

NB_MODULE(_native, module) {
    module.doc() = "The compiled part of station_kord; use that instead.";
    module.attr("BACKEND") = station_kord::backend();
    station_kord::bind_errors(module);
    station_kord::bind_state(module);
    station_kord::bind_simulator(module);
    station_kord::bind_bridge(module);
}
