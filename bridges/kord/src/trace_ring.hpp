// The last ticks, row by row, for plots. The loop never waits to write one: while somebody reads, rows are left out.
#pragma once

#include <mutex>
#include <vector>

#include "types.hpp"

namespace station_kord {

#pragma pack(push, 1)
struct TraceRow {  // as station_kord.TRACE has it
    int64_t tick = 0;
    double q[kJoints] = {}, qd[kJoints] = {}, q_target[kJoints] = {}, q_sent[kJoints] = {};
    double queued_motion_s = 0;
    int32_t planner_backlog = -1;
    uint8_t sent = 0, late = 0, moving = 0, fault = 0;
};
#pragma pack(pop)

class TraceRing {
public:
    explicit TraceRing(int rows);

    bool push(const TraceRow& row);
    std::vector<TraceRow> last(int64_t rows) const;

private:
    mutable std::mutex mutex_;
    std::vector<TraceRow> rows_;
    int64_t count_ = 0;
};

}  // namespace station_kord
