// Clearing alarms: one request at a time, and on to the next when the controller has confirmed it.
#pragma once

#include "arm_session.hpp"

namespace station_kord {

enum class Outcome : int32_t { working, cleared, needs_user, refused, too_late, no_answer };

class Recovery {
public:
    void begin(int64_t deadline_ticks);
    bool is_working() const { return outcome_ == Outcome::working; }
    Outcome outcome() const { return outcome_; }

    // One tick's part; sends at most one request. With no session it opens one anew, which takes its time.
    void work(ArmSession& session, bool is_connected);

private:
    // Requests what the controller's words call for; where they call for nothing, it is waited until they change.
    void ask(ArmSession& session);

    Outcome outcome_ = Outcome::cleared;
    int64_t ticks_left_ = 0, token_ = 0;
};

}  // namespace station_kord
