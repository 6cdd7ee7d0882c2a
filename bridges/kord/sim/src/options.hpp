// What a simulated controller is like; station_kord.SimOptions says what each number means.
#pragma once

#include <array>
#include <cstdint>

namespace kordsim {

using Joints = std::array<double, 7>;
using Pose = std::array<double, 6>;

constexpr int kJoints = 7;
constexpr double kTickS = 0.004;
constexpr int64_t kTickNs = 4'000'000;
constexpr double kMovingRadps = 0.01;  // below this the rules of motion do not hold
constexpr double kPi = 3.14159265358979323846;

struct Options {
    bool is_virtual = false;
    Joints q_start{};
    Joints q_min{-2 * kPi, -70 * kPi / 180, -2 * kPi, -70 * kPi / 180, -2 * kPi, -2 * kPi, -2 * kPi};
    Joints q_max{2 * kPi, kPi, 2 * kPi, kPi, 2 * kPi, 2 * kPi, 2 * kPi};
    double qd_max_radps = 225 * kPi / 180;
    double qdd_max_radps2 = 10'000 * kPi / 180;
    double window_us = 1500;
    bool fetch_closes_window = true;
    int buffer_len = 150;
    double planner_time_ms = 5.0;
    double planner_speed_ms = 6.0;
    double torque_deviation_rad = 0.0006;
    int late_fault_ticks = 3;
    int ack_ticks = 4;
    int watchdog_ticks = 20;
    bool ceased_is_fault = false;
    double speed_noise_radps = 0;
    uint64_t noise_seed = 1;
    bool is_opaque = false;
    bool queues_after_stop_point = false;
};

}  // namespace kordsim
