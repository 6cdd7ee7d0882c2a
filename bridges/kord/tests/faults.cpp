// K3, K4, K10, K11.
#include "arm.hpp"
#include "check.hpp"

using namespace tests;

TEST(k3_reading_before_sending_faults_as_soon_as_the_arm_moves) {
    Setup setup;
    setup.fetch_first = true;
    Arm arm(setup);
    const State state = arm.stream(100);
    CHECK(arm.told(1010));
    CHECK(state.late_commands == state.stream_j_sends);
    int64_t moved = 0, faulted = 0;
    for (const auto& row : arm.bridge().trace(-1)) {
        if (moved == 0 && std::abs(row.qd[0]) > 0.01) moved = row.tick;
        if (faulted == 0 && row.fault) faulted = row.tick;
    }
    CHECK(moved > 0 && faulted - moved <= 3);
}

static void late(double speed_radps, bool faults) {
    Arm arm;
    CHECK(arm.direct(100, speed_radps).event_count == 0);
    arm.plant().delay_commands(1);
    for (int tick = 0; tick < 4 && !arm.state().is_faulted; ++tick) arm.direct_step(speed_radps);
    CHECK(arm.told(1010) == faults);
    CHECK(arm.state().late_commands == 1);
}

TEST(k4_one_late_direct_command_faults_a_fast_arm) { late(0.3, true); }
TEST(k4_and_a_slow_one_not) { late(0.1, false); }

TEST(k10_after_a_fault_the_arm_starts_from_where_it_is) {
    Arm arm;
    arm.stream(250);
    arm.plant().raise_event(1010);
    State state = arm.step(10);
    CHECK(state.is_faulted && !state.is_engaged && !state.is_moving && state.fault_count == 1);
    CHECK(is_refused("Refused", [&] { arm.bridge().stream_j(state.q); }));
    CHECK(is_refused("Refused", [&] { arm.bridge().engage(); }));
    arm.bridge().clear_faults(5.0);
    state = arm.state();
    CHECK(!state.is_faulted && state.alarm_state == 0);
    CHECK(is_refused("Refused", [&] { arm.bridge().stream_j(state.q); }));
    const int64_t sends = arm.step(50).stream_j_sends;
    const Joints q = arm.bridge().engage();
    arm.bridge().stream_j(q);
    state = arm.step(2);
    CHECK(state.stream_j_sends == sends + 1);
    CHECK_NEAR(state.q_sent[0], state.q[0], 1e-6);
    CHECK(arm.stream(250).event_count == 1);
}

TEST(k10_a_lost_connection_is_opened_anew) {
    Arm arm;
    arm.stream(100);
    arm.plant().raise_event(3002);
    CHECK(!arm.step(40).is_connected);
    arm.bridge().clear_faults(5.0);
    CHECK(arm.state().is_connected && !arm.state().is_faulted);
}

TEST(a_paused_controller_ends_the_engagement_and_hears_nothing_more) {
    Arm arm;
    for (int tick = 0; tick < 100; ++tick) {
        arm.bridge().velocity_j(joint_one(kSpeedRadps));
        arm.step();
    }
    arm.plant().pause(true);
    const int64_t sends = arm.step(2).direct_sends;
    State state = arm.step(50);
    CHECK(!state.is_engaged && !state.is_faulted && state.direct_sends == sends && state.event_count == 0);
    CHECK(is_refused("Refused", [&] { arm.bridge().engage(); }));
    arm.plant().pause(false);
    arm.step(2);
    CHECK(is_refused("Refused", [&] { arm.bridge().stream_j(state.q); }));
    arm.bridge().engage();
    CHECK(arm.stream(50).event_count == 0);
}

TEST(a_move_that_is_held_ends_before_its_goal) {
    Arm arm;
    arm.bridge().move_j(joint_one(1.0), 0.5);
    const double q = arm.step(150).q[0];
    arm.bridge().hold();
    const State state = arm.step(60);
    CHECK(!state.is_moving && state.event_count == 0 && state.move_sends == 2);
    CHECK(state.q[0] > q && state.q[0] < 0.5);
}

TEST(a_target_that_could_not_leave_is_sent_in_the_next_tick) {
    Arm arm;
    arm.stream(50);
    arm.plant().fail_sends(3);
    const double target = arm.stream(3).q_target[0];
    const State state = arm.step(30);
    CHECK(state.failed_sends == 3 && state.event_count == 0);
    CHECK_NEAR(state.q[0], target, 1e-9);
}

TEST(k11_a_velocity_that_nobody_renews_is_zero_after_100_ms) {
    Arm arm;
    for (int tick = 0; tick < 100; ++tick) {
        arm.bridge().velocity_j(joint_one(kSpeedRadps));
        arm.step();
    }
    CHECK_NEAR(arm.state().qd[0], kSpeedRadps, 1e-9);
    const State state = arm.step(26);
    CHECK(state.qd[0] == 0 && state.event_count == 0);
}

TEST(k11_a_stream_that_nobody_renews_holds_its_last_target) {
    Arm arm;
    const double target = arm.stream(250).q_target[0];
    const State state = arm.step(2500);
    CHECK_NEAR(state.q[0], target, 1e-9);
    CHECK(state.event_count == 0);
}
