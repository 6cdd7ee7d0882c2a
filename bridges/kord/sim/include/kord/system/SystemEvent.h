// Stand-in, see ../api/kord.h.
#pragma once

#include <cstdint>

namespace kr2::kord::protocol {

enum EEventGroup { eUnknown = 0, eSafetyEvent, eSoftStopEvent, eKordEvent };

struct SystemEvent {
    int64_t timestamp_{};
    uint32_t event_id_{};
    uint16_t event_group_{};
};

}  // namespace kr2::kord::protocol
