// One row per tick, as station_kord.TRACE lays it out; a ring that is never longer than it began.
#pragma once

#include <cstdint>
#include <vector>

namespace kordsim {

#pragma pack(push, 1)
struct TraceRow {
    int64_t tick = 0;
    double q[7] = {}, qd[7] = {}, q_target[7] = {}, q_sent[7] = {};
    double queued_motion_s = 0;
    int32_t planner_backlog = 0;
    uint8_t sent = 0, late = 0, moving = 0, fault = 0;
};
#pragma pack(pop)

}  // namespace kordsim
