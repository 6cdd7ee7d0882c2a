// What a person reads of an event.
#pragma once

#include <cstdint>
#include <string>

namespace station_kord {

// In four digits.
std::string number(double value);

const char* group_name(uint32_t group);
const char* event_text(uint32_t id);

// Why a controller takes no commands though nothing is wrong, by its motion flags: ``paused``; empty where it does.
std::string not_ready_text(uint32_t motion_flags);

}  // namespace station_kord
