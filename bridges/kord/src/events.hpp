// What a person reads of an event.
#pragma once

#include <cstdint>

namespace station_kord {

const char* group_name(uint32_t group);
const char* event_text(uint32_t id);

}  // namespace station_kord
