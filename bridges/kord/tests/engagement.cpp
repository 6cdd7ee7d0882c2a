// What is asked for in the middle of a tick, or by several threads at once: nothing of it goes on unasked.
#include <atomic>
#include <thread>

#include "arm.hpp"
#include "check.hpp"

using namespace tests;

namespace {

// An arm, and what a caller does while the loop is between the command and its report of it.
class Interrupted {
public:
    Interrupted() {
        Setup setup;
        setup.meanwhile = [this] {
            if (act_ && ++calls_ == 2) act_();
        };
        arm_ = std::make_unique<Arm>(setup);
    }

    Bridge& bridge() { return arm_->bridge(); }

    State tick_in_which(std::function<void()> act) {
        calls_ = 0;
        act_ = std::move(act);
        arm_->step();
        CHECK(calls_ == 2);
        act_ = nullptr;
        return arm_->state();
    }

    State step(int64_t ticks) { return arm_->step(ticks); }

private:
    int calls_ = 0;
    std::function<void()> act_;
    std::unique_ptr<Arm> arm_;  // last: its loop calls
};

// Stands, soon after it began to move to 1 rad.
void check_stopped(const State& state) {
    CHECK(!state.is_moving && state.event_count == 0 && state.move_sends == 2);
    CHECK(state.q[0] < 0.1);
}

}  // namespace

TEST(an_arm_that_is_engaged_anew_in_the_tick_in_which_its_move_begins_is_held_and_not_engaged) {
    Interrupted arm;
    arm.bridge().move_j(joint_one(1.0), 0.5);
    arm.tick_in_which([&] {
        arm.bridge().disengage();
        arm.bridge().engage();
    });
    CHECK(!arm.step(1).is_engaged);
    check_stopped(arm.step(100));
    arm.bridge().engage();
    CHECK(arm.step(1).is_engaged);
}

TEST(a_hold_is_not_undone_by_what_is_asked_for_next_in_the_same_tick) {
    Interrupted arm;
    arm.bridge().move_j(joint_one(1.0), 0.5);
    const State state = arm.tick_in_which([&] {
        arm.bridge().hold();
        arm.bridge().stream_j(joint_one(0.0));
    });
    CHECK(state.move_sends == 1);
    check_stopped(arm.step(100));
    CHECK(arm.step(1).limit_refusals == 1);
}

TEST(what_was_revoked_stays_revoked_whoever_disengages_late) {
    Arm arm;
    std::atomic<bool> stops{false};
    std::thread other([&] {
        while (!stops) arm.bridge().disengage();
    });
    int again = 0;
    for (int turn = 0; turn < 200'000; ++turn) {
        arm.bridge().engage();
        arm.bridge().disengage();
        again += arm.state().is_engaged;
    }
    stops = true;
    other.join();
    CHECK(again == 0);
}

TEST(a_move_that_begins_too_gently_to_be_seen_is_known_to_be_under_way_and_can_be_stopped) {
    for (const bool ends_by_hold : {true, false})
        for (const int ticks : {1, 6, 10, 20}) {
            Setup setup;
            setup.options.is_opaque = true;
            Arm arm(setup);
            arm.bridge().move_j(joint_one(1.0), 0.1);
            State state = arm.step(ticks);
            CHECK(state.is_moving && state.queued_motion_s != state.queued_motion_s);
            CHECK(is_refused("Refused", [&] { arm.bridge().engage(); }));
            ends_by_hold ? arm.bridge().hold() : arm.bridge().disengage();
            state = arm.step(60);
            CHECK(!state.is_moving && state.move_sends == 2 && state.event_count == 0);
            CHECK(arm.step(2500).q[0] < 0.001);
        }
}

TEST(a_move_is_over_where_it_leads_also_for_who_knows_no_more_than_a_real_controller_tells) {
    for (const double goal : {0.0, 1e-4, 0.2}) {
        Setup setup;
        setup.options.is_opaque = true;
        Arm arm(setup);
        arm.bridge().move_j(joint_one(goal), 0.5);
        const State state = arm.step(200);
        CHECK(!state.is_moving && state.mode == station_kord::Mode::idle);
        CHECK_NEAR(state.q[0], goal, 1e-9);
        arm.bridge().move_l(state.tcp_pose, 0.1);
        CHECK(!arm.step(50).is_moving);
    }
}

TEST(an_arm_that_is_being_left_is_driven_by_nobody_and_who_comes_back_finds_it_free) {
    for (const bool drives : {true, false}) {
        Setup setup;
        Arm* here = nullptr;
        std::atomic<bool> is_closing{false};
        int granted = 0;
        setup.meanwhile = [&] {
            if (!is_closing) return;
            is_refused("", [&] {
                here->bridge().engage();
                ++granted;
                if (drives) here->bridge().move_j(joint_one(1.0), 0.5);
            });
        };
        Arm arm(setup);
        here = &arm;
        arm.step(10);
        is_closing = true;
        arm.bridge().close();
        is_closing = false;
        CHECK(granted > 0);
        for (const auto& row : arm.plant().trace(-1)) CHECK(row.q[0] == 0);
        arm.bridge().connect(10.0);
        CHECK(!arm.step(1).is_engaged && !arm.state().is_moving);
    }
}

TEST(an_arm_whose_session_is_lost_in_a_move_is_stopped_when_it_comes_back) {
    Arm arm;
    arm.bridge().move_j(joint_one(1.0), 0.2);
    arm.step(100);
    arm.plant().silence(true);
    CHECK(!arm.step(60).is_connected);
    arm.plant().silence(false);
    const double q = arm.step(1).q[0];
    const State state = arm.step(60);
    CHECK(state.is_connected && !state.is_engaged && !state.is_moving && state.event_count == 1);
    CHECK(state.q[0] > q && state.q[0] < q + 0.2 * 1.9 * 0.1);
}

TEST(a_far_target_of_a_stream_is_not_gone_to_once_it_is_held) {
    for (const int end : {0, 1, 2}) {
        Setup setup;
        setup.options.is_opaque = end == 0;
        Arm arm(setup);
        arm.bridge().stream_j(joint_one(1.0));
        const double q = arm.step(100).q[0];
        if (end == 0) arm.bridge().hold();
        if (end == 1) arm.bridge().disengage();
        if (end == 2) arm.bridge().close();
        if (end < 2) CHECK(arm.step(60).event_count == 0 && !arm.state().is_moving);
        const double after = arm.plant().trace(1).front().q[0];
        CHECK(after > q && after < q + kSpeedRadps * 0.1);
        CHECK(arm.plant().trace(1).front().qd[0] == 0);
    }
}
