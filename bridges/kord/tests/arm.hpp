// An arm for the tests: a bridge and its simulated controller, and hands that drive it.
#pragma once

#include <cmath>
#include <functional>
#include <memory>

#include "bridge.hpp"
#include "plant.hpp"

namespace tests {

using station_kord::Bridge;
using station_kord::Joints;
using station_kord::Profile;
using station_kord::State;

constexpr double kSpeedRadps = 0.3, kTickS = 0.004, kQddMaxRadps2 = 10.0;

Profile speed125();
Profile time250();
Profile legacy_stop();

struct Setup {
    Profile profile = speed125();
    kordsim::Options options;
    bool fetch_first = false, resend_targets = false;
    int real_time_priority = 0;
    bool lock_memory = false;
    bool is_virtual = true;
    std::function<void()> meanwhile;  // in the loop's thread: as a tick begins, and before it tells of what it did
};

// Connected and engaged.
class Arm {
public:
    explicit Arm(Setup setup = {});

    Bridge& bridge() { return *bridge_; }
    kordsim::Plant& plant() { return *plant_; }
    State state() const { return bridge_->state(); }
    State step(int64_t ticks = 1);

    // The target of joint 1 runs for so many ticks, written on every so-manieth, or until a fault.
    State stream(int ticks, double speed_radps = kSpeedRadps, int every = 1);

    // Direct commands up to a speed, as fast as the limits allow, and on at that speed.
    State direct(int ticks, double speed_radps);
    void direct_step(double speed_radps);

    bool told(uint32_t condition) const;

private:
    std::shared_ptr<kordsim::Plant> plant_;
    std::unique_ptr<Bridge> bridge_;
    Joints q_{};
    double speed_radps_ = 0;
};

Joints joint_one(double value);
bool is_refused(const char* kind, const std::function<void()>& command);

}  // namespace tests
