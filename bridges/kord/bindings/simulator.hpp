// A simulated controller as Python holds it; of a build for real controllers there is none, see no_simulator.cpp.
#pragma once

#include <memory>
#include <string>

#include "types.hpp"

namespace kordsim {
class Plant;
}

namespace station_kord {

struct Simulator {
    std::shared_ptr<kordsim::Plant> plant;
    std::string name;  // what a session has for a host

    Hooks hooks() const;
};

}  // namespace station_kord
