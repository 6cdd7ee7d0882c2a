#include "trace_ring.hpp"

#include <algorithm>

namespace station_kord {

namespace {

constexpr int64_t kAtOnce = 128;  // rows copied while the loop would have to leave one out

}  // namespace

TraceRing::TraceRing(int rows) : rows_(static_cast<size_t>(std::max(0, rows))) {}

bool TraceRing::push(const TraceRow& row) {
    if (rows_.empty()) return true;
    const std::unique_lock lock(mutex_, std::try_to_lock);
    if (!lock.owns_lock()) return false;
    rows_[static_cast<size_t>(count_++) % rows_.size()] = row;
    return true;
}

std::vector<TraceRow> TraceRing::last(int64_t rows) const {
    std::vector<TraceRow> out;
    std::unique_lock lock(mutex_);
    const auto length = static_cast<int64_t>(rows_.size());
    const int64_t end = count_, held = std::min(end, length);
    int64_t row = end - (rows < 0 ? held : std::min(rows, held));
    lock.unlock();
    out.reserve(static_cast<size_t>(end - row));
    while (row < end) {
        lock.lock();
        for (const int64_t stop = std::min(end, row + kAtOnce); row < stop; ++row)
            if (count_ - row <= length) out.push_back(rows_[static_cast<size_t>(row % length)]);
        lock.unlock();
    }
    return out;
}

}  // namespace station_kord
