#include "histogram.hpp"

#include <algorithm>
#include <cmath>

namespace station_kord {

namespace {

constexpr double kGrowth = 1.005;

}  // namespace

void Histogram::add(double us) {
    timing_.last = us;
    timing_.max = std::max(timing_.max, us);
    ++counts_[static_cast<size_t>(bucket_of(us))];
    if (++total_ == 1) update();
}

void Histogram::update() {
    timing_.p50 = percentile(0.50);
    timing_.p99 = percentile(0.99);
}

int Histogram::bucket_of(double us) {
    if (us < kFine) return std::max(0, static_cast<int>(us));
    return std::min(kFine + kCoarse - 1, kFine + static_cast<int>(std::log(us / kFine) / std::log(kGrowth)));
}

double Histogram::middle_of(int bucket) {
    if (bucket < kFine) return bucket + 0.5;
    return kFine * std::pow(kGrowth, bucket - kFine + 0.5);
}

double Histogram::percentile(double share) const {
    const auto wanted = static_cast<uint64_t>(std::ceil(share * static_cast<double>(total_)));
    uint64_t seen = 0;
    for (int bucket = 0; bucket < kFine + kCoarse; ++bucket) {
        seen += counts_[static_cast<size_t>(bucket)];
        if (seen >= wanted && seen > 0) return std::min(middle_of(bucket), timing_.max);
    }
    return timing_.max;
}

}  // namespace station_kord
