// The only place where the two libraries that the bridge may be linked with differ.
#pragma once

#include <kord/api/kord.h>

#include "types.hpp"

namespace station_kord {

// ``sim`` or ``kord``.
const char* backend();

// What a simulated controller tells beyond kord-api; false for a real one.
bool look_inside(kr2::kord::KordCore& core, Insight& insight);

}  // namespace station_kord
