// The controller's rules by themselves, without a bridge: when a command acts, and what happens when none comes.
#include "check.hpp"
#include "controller.hpp"

using namespace kordsim;

namespace {

Command target(const Controller& controller, double q, double offset_us = 0) {
    Command command;
    command.tracking_value = 0.016;
    command.q[0] = q;
    command.tick = controller.status().tick;
    command.offset_us = offset_us;
    return command;
}

Command direct(const Controller& controller, double q, double qd) {
    Command command = target(controller, q);
    command.kind = CommandKind::direct;
    command.qd[0] = qd;
    return command;
}

void tick(Controller& controller, int ticks = 1) {
    for (int i = 0; i < ticks; ++i) {
        controller.waited();
        controller.tick(0);
    }
}

uint32_t condition(const Controller& controller) { return controller.status().alarm >> 8; }

// Up to 0.3 rad/s by direct commands.
void speed_up(Controller& controller) {
    double q = 0, qd = 0;
    controller.receive(direct(controller, q, qd));
    tick(controller);
    while (qd < 0.3) {
        qd += 0.1;
        q += qd * kTickS;
        controller.receive(direct(controller, q, qd));
        tick(controller);
    }
    CHECK(condition(controller) == 0);
}

}  // namespace

TEST(r2_a_command_within_the_window_acts_in_the_next_tick_and_a_late_one_in_the_one_after) {
    for (const double offset_us : {0.0, 1500.0, 1501.0}) {
        Controller controller(Options{});
        controller.open();
        tick(controller, 3);
        controller.receive(target(controller, 0.001, offset_us));
        tick(controller);
        const bool is_late = offset_us > 1500;
        CHECK((controller.status().qd[0] != 0) == !is_late);
        CHECK(controller.status().late_commands == is_late);
        tick(controller);
        CHECK(controller.status().qd[0] != 0);
    }
}

TEST(r2_reading_closes_the_window_where_it_does) {
    for (const bool closes : {true, false}) {
        Options options;
        options.fetch_closes_window = closes;
        Controller controller(options);
        controller.open();
        tick(controller);
        Command command = target(controller, 0.001);
        command.was_fetched = 1;
        controller.receive(command);
        CHECK(controller.status().late_commands == closes);
    }
}

TEST(r3_a_direct_command_from_another_mode_must_be_where_the_arm_is) {
    Controller controller(Options{});
    controller.open();
    tick(controller);
    controller.receive(direct(controller, 0.001, 0));
    tick(controller);
    CHECK(condition(controller) == 1010);
}

TEST(r9_an_arm_whose_direct_commands_cease_comes_to_rest) {
    for (const bool is_fault : {false, true}) {
        Options options;
        options.ceased_is_fault = is_fault;
        options.qdd_max_radps2 = 20;
        Controller controller(options);
        controller.open();
        speed_up(controller);
        tick(controller, 10);
        CHECK(controller.status().qd[0] == 0);
        CHECK(condition(controller) == (is_fault ? 3001u : 0u));
    }
}

TEST(r9_targets_that_none_follows_are_a_fault_where_the_controller_minds_and_a_stop_point_is_not) {
    for (const bool minds : {false, true})
        for (const bool stops : {false, true}) {
            Options options;
            options.ceased_is_fault = minds;
            Controller controller(options);
            controller.open();
            tick(controller);
            for (int turn = 1; turn <= 20; ++turn) {  // a stream in the vendor's slowest rhythm
                Command command = target(controller, 0.02 * turn);
                command.tracking_value = 0.5;
                if (turn == 20) command.stops_at_point = stops;
                controller.receive(command);
                tick(controller, 4);
                CHECK(condition(controller) == 0);
            }
            tick(controller, 2);
            CHECK(condition(controller) == (minds && !stops ? 3001u : 0u));
        }
}

TEST(r10_a_stopped_controller_takes_commands_and_does_nothing) {
    Controller controller(Options{});
    controller.open();
    tick(controller);
    controller.fault(2005);
    controller.receive(target(controller, 0.001));
    tick(controller, 5);
    CHECK(controller.status().q[0] == 0);
    controller.receive(Clear{1, 0, 7});
    tick(controller, 3);
    CHECK(condition(controller) == 2005);
    tick(controller);
    CHECK(condition(controller) == 0 && controller.status().acknowledged[0].token == 7);
}

TEST(r11_a_speed_beyond_the_limit_is_a_soft_stop) {
    Controller controller(Options{});
    controller.open();
    tick(controller);
    Command command = target(controller, 0.5);
    command.tracking = Tracking::joint_speed;
    command.tracking_value = 4.0;
    controller.receive(command);
    tick(controller);
    CHECK(condition(controller) == 2002);
}

TEST(r12_nobody_who_waits_in_motion_is_a_fault_after_twenty_ticks) {
    Controller controller(Options{});
    controller.open();
    tick(controller);
    Command command = target(controller, 0.5);
    command.tracking_value = 2.0;
    controller.receive(command);
    for (int i = 0; i < 18; ++i) controller.tick(0);
    CHECK(condition(controller) == 0);
    controller.tick(0);
    CHECK(condition(controller) == 3001);
    controller.tick(0);
    CHECK(controller.status().qd[0] == 0);
}
