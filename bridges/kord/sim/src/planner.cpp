#include "planner.hpp"

#include <algorithm>

namespace kordsim {

namespace {

constexpr double kTickMs = kTickS * 1e3, kRoundingMs = 1e-9;

}  // namespace

Planner::Planner(const Options& options) : options_(options), costs_ms_(static_cast<size_t>(options.buffer_len) + 1) {}

bool Planner::accept(const Command& move) {
    const auto length = static_cast<int>(costs_ms_.size());
    if (count_ == length) return false;
    const double cost_ms = move.tracking == Tracking::time ? options_.planner_time_ms : options_.planner_speed_ms;
    costs_ms_[static_cast<size_t>((first_ + count_++) % length)] = cost_ms;
    return count_ <= options_.buffer_len;
}

void Planner::pass() {
    debt_ms_ = std::max(0.0, debt_ms_ - kTickMs);
    while (count_ > 0 && debt_ms_ < kTickMs - kRoundingMs) {
        debt_ms_ += costs_ms_[static_cast<size_t>(first_)];
        first_ = (first_ + 1) % static_cast<int>(costs_ms_.size());
        --count_;
    }
}

void Planner::clear() {
    first_ = count_ = 0;
    debt_ms_ = 0;
}

}  // namespace kordsim
