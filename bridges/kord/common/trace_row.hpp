// One row per tick, as station_kord.TRACE lays it out; the bridge and the simulated controller both write such rows.
#pragma once

#include <cstdint>

namespace station_kord {

#pragma pack(push, 1)
struct TraceRow {
    int64_t tick = 0;
    double q[7] = {}, qd[7] = {}, q_target[7] = {}, q_sent[7] = {};
    double queued_motion_s = 0;
    int32_t planner_backlog = -1;
    uint8_t sent = 0, late = 0, moving = 0, fault = 0;
};
#pragma pack(pop)

static_assert(sizeof(TraceRow) == 248, "station_kord/state.py has the same fields");

}  // namespace station_kord
