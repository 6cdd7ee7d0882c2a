// How a bridge lives by the time of a simulated controller.
#pragma once

#include <memory>

#include "types.hpp"

namespace kordsim {
class Plant;
}

namespace station_kord {

Hooks hooks_of(const std::shared_ptr<kordsim::Plant>& plant);

}  // namespace station_kord
