// The last ticks, row by row, for plots. The loop never waits to write one: while somebody reads, rows are left out.
#pragma once

#include <mutex>
#include <vector>

#include "trace_row.hpp"

namespace station_kord {

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
