// K1, K2, K5 to K9.
#include "arm.hpp"
#include "check.hpp"

using namespace tests;

TEST(k1_an_idle_loop_ticks_and_sends_nothing) {
    Arm arm;
    const State state = arm.step(2500);
    CHECK(state.tick == 2500 && state.stream_j_sends == 0 && state.event_count == 0);
}

TEST(k2_a_stream_is_sent_on_every_second_tick) {
    Arm arm;
    State state = arm.stream(2500);
    CHECK_NEAR(state.stream_j_sends, 1250, 1);
    const double target = state.q_target[0];
    state = arm.step(50);
    CHECK_NEAR(state.q[0], target, 1e-9);
    CHECK(state.event_count == 0 && !state.is_moving);
}

static void overflow(double planner_speed_ms, double seconds) {
    Setup setup;
    setup.options.planner_speed_ms = planner_speed_ms;
    Arm arm(setup);
    arm.bridge().set_throttle(1);
    const State state = arm.stream(1000);
    CHECK(arm.told(3001));
    CHECK_NEAR(state.tick * kTickS, seconds, 0.05);
}

TEST(k2_without_the_throttle_the_planner_overflows_final) { overflow(6.0, 1.8); }
TEST(k2_without_the_throttle_the_planner_overflows_narrative) { overflow(8.4, 1.14); }

TEST(k5_stop_points_pile_up) {
    Setup setup;
    setup.profile = legacy_stop();
    Arm arm(setup);
    const State state = arm.stream(100, kSpeedRadps, 2);
    CHECK_NEAR(state.queued_motion_s, 100, 2);
    CHECK(arm.step(22'500).is_moving);
}

TEST(k5_via_points_do_not) {
    for (const Profile& profile : {speed125(), time250()}) {
        Setup setup;
        setup.profile = profile;
        Arm arm(setup);
        CHECK(arm.stream(100).queued_motion_s <= 0.05);
    }
}

TEST(k6_a_hold_that_is_sent_again_suspends_the_arm) {
    Setup setup;
    setup.profile = time250();
    setup.resend_targets = true;
    Arm arm(setup);
    arm.bridge().stream_j(arm.state().q);
    const int64_t first = arm.step().tick;
    while (!arm.step().is_faulted) CHECK(arm.state().tick < 1500);
    CHECK_NEAR((arm.state().tick - first) * kTickS, 2.98, 0.1);
    CHECK(arm.told(3001));
}

TEST(k6_a_hold_that_is_not_sent_lasts) {
    Arm arm;
    arm.bridge().stream_j(arm.state().q);
    const int64_t sends = arm.step(10).stream_j_sends;
    const State state = arm.step(15'000);
    CHECK(state.stream_j_sends == sends && state.event_count == 0);
}

static void offset(const Profile& profile, double offset_rad, bool faults) {
    Setup setup;
    setup.profile = profile;
    Arm arm(setup);
    arm.bridge().stream_j(joint_one(offset_rad));
    const State state = arm.step(500);
    CHECK(arm.told(3002) == faults);
    CHECK(state.is_connected != faults);
    CHECK((state.sync_timeouts > 0) == faults);
    CHECK_NEAR(state.q[0], faults ? 0.0 : offset_rad, 1e-6);
}

TEST(k7_a_target_too_far_for_its_time_ends_the_connection) { offset(time250(), 0.010, true); }
TEST(k7_a_near_one_does_not) { offset(time250(), 0.001, false); }
TEST(k7_a_speed_takes_its_time) { offset(speed125(), 0.5, false); }
TEST(k7_the_guard_goes_in_steps) {
    Profile profile = time250();
    profile.offset_guard = true;
    offset(profile, 0.5, false);
}

static void a_minute(double planner_speed_ms, bool suspends) {
    Setup setup;
    setup.options.planner_speed_ms = planner_speed_ms;
    Arm arm(setup);
    const State state = arm.stream(15'000, 0.1);
    CHECK(arm.told(3001) == suspends);
    CHECK_NEAR(state.tick * kTickS, suspends ? 25.0 : 60.0, suspends ? 2.0 : 0.1);
}

TEST(k8_a_minute_with_the_narrative_planner) { a_minute(8.4, true); }
TEST(k8_a_minute_with_the_final_planner) { a_minute(6.0, false); }

TEST(k9_the_throttle_changes_the_rate_at_once) {
    Arm arm;
    const int64_t before = arm.stream(500).stream_j_sends;
    arm.bridge().set_throttle(4);
    const int64_t after = arm.stream(500).stream_j_sends;
    CHECK(before == 250);
    CHECK_NEAR(after - before, 125, 1);
}
