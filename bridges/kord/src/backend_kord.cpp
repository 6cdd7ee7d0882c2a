#include "backend.hpp"

namespace station_kord {

const char* backend() { return "kord"; }

bool look_inside(kr2::kord::KordCore&, Insight&) { return false; }

}  // namespace station_kord
