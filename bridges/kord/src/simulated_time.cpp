#include "simulated_time.hpp"

#include "plant.hpp"

namespace station_kord {

Hooks hooks_of(const std::shared_ptr<kordsim::Plant>& plant) {
    Hooks hooks;
    if (!plant->options().is_virtual) return hooks;
    hooks.now_ns = [plant] { return plant->now_ns(); };
    hooks.step = [plant](int64_t ticks) { return plant->step(ticks); };
    hooks.run_free = [plant](bool is_free) { plant->run_free(is_free); };
    return hooks;
}

}  // namespace station_kord
