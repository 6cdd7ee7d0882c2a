// Percentiles of durations without memory that grows: counts per bucket, 1 µs wide at first and 0.5 % further on.
#pragma once

#include <array>
#include <cstdint>

#include "types.hpp"

namespace station_kord {

class Histogram {
public:
    void add(double us);
    void update();  // percentiles; a walk over all buckets, for now and then
    const Timing& timing() const { return timing_; }

private:
    static constexpr int kFine = 200, kCoarse = 1200;

    static int bucket_of(double us);
    static double middle_of(int bucket);
    double percentile(double share) const;

    std::array<uint32_t, kFine + kCoarse> counts_{};
    uint64_t total_ = 0;
    Timing timing_;
};

}  // namespace station_kord
