#include "recovery.hpp"

namespace station_kord {

using Request = kr2::kord::ControlInterface;

void Recovery::begin(int64_t deadline_ticks) {
    outcome_ = Outcome::working;
    ticks_left_ = deadline_ticks;
    token_ = 0;
}

void Recovery::work(ArmSession& session, bool is_connected) {
    if (--ticks_left_ < 0) {
        outcome_ = is_connected ? Outcome::too_late : Outcome::no_answer;
        return;
    }
    if (!is_connected) {
        token_ = 0;
        if (!session.reopen()) outcome_ = Outcome::no_answer;
        return;
    }
    const Reading& reading = session.reading();
    if (reading.needs_user()) {
        outcome_ = Outcome::needs_user;
    } else if (token_ != 0) {
        const int8_t status = session.status_of(token_);
        if (status > 0) outcome_ = Outcome::refused;
        if (status == 0) token_ = 0;
    } else if (!reading.is_stopped()) {
        outcome_ = Outcome::cleared;
    } else {
        ask(session);
    }
}

void Recovery::ask(ArmSession& session) {
    const Reading& reading = session.reading();
    if (reading.motion_flags & kHalt)
        token_ = session.clear(Request::CLEAR_HALT);
    else if (reading.motion_flags & kSuspended)
        token_ = session.clear(Request::UNSUSPEND);
    else if (reading.is_kords())
        token_ = session.clear(Request::CBUN_EVENT);
}

}  // namespace station_kord
