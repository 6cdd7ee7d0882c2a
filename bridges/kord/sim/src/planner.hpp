// The work of the controller's planner: every move costs time, and waits in a buffer of limited length until it is
// done. A move acts in the tick after it came, whatever waits; what grows is the buffer.
#pragma once

#include <vector>

#include "messages.hpp"

namespace kordsim {

class Planner {
public:
    explicit Planner(const Options& options);

    // False when the buffer is full.
    bool accept(const Command& move);

    // Let a tick of work pass.
    void pass();
    void clear();
    int backlog() const { return count_; }

private:
    const Options& options_;
    std::vector<double> costs_ms_;  // a ring
    int first_ = 0, count_ = 0;
    double debt_ms_ = 0;  // work begun and not done; the next move is begun in the tick in which this ends
};

}  // namespace kordsim
