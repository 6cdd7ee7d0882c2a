#include "arm.hpp"

#include <algorithm>
#include <cstring>

#include "simulated_time.hpp"

namespace tests {

namespace {

Profile named(const char* name) {
    Profile profile;
    std::strncpy(profile.name.data(), name, profile.name.size() - 1);
    return profile;
}

station_kord::BridgeConfig config_of(const Setup& setup, const std::string& host) {
    station_kord::BridgeConfig config;
    config.host = host;
    config.q_min = setup.options.q_min;
    config.q_max = setup.options.q_max;
    config.qd_max.fill(2.0);
    config.qdd_max.fill(kQddMaxRadps2);
    config.profile = setup.profile;
    config.is_simulated = true;
    config.fetch_first = setup.fetch_first;
    config.resend_targets = setup.resend_targets;
    config.real_time_priority = setup.real_time_priority;
    config.lock_memory = setup.lock_memory;
    config.trace_ticks = 5000;
    return config;
}

}  // namespace

Profile speed125() { return named("speed125"); }

Profile time250() {
    Profile profile = named("time250");
    profile.tracks_time = true;
    profile.tracking_value = 0.008;
    profile.blend_s = 0.004;
    profile.throttle = 1;
    profile.guard_qdd_radps2 = kordsim::Options{}.qdd_max_radps2;
    return profile;
}

Profile legacy_stop() {
    Profile profile = named("legacy-stop");
    profile.tracks_time = true;
    profile.tracking_value = 2.0;
    profile.blends = false;
    profile.stops_at_points = true;
    profile.throttle = 1;
    profile.sim_only = true;
    return profile;
}

Arm::Arm(Setup setup) {
    setup.options.is_virtual = setup.is_virtual;
    plant_ = std::make_shared<kordsim::Plant>(setup.options);
    station_kord::Hooks hooks = station_kord::hooks_of(plant_);
    if (setup.meanwhile)
        hooks.now_ns = [meanwhile = setup.meanwhile, now_ns = hooks.now_ns] {
            meanwhile();
            return now_ns();
        };
    bridge_ = std::make_unique<Bridge>(config_of(setup, kordsim::enroll(plant_)), std::move(hooks));
    bridge_->connect(10.0);
    q_ = bridge_->engage();
}

State Arm::step(int64_t ticks) {
    bridge_->step(ticks);
    return state();
}

State Arm::stream(int ticks, double speed_radps, int every) {
    q_ = state().q_target;
    for (int tick = 0; tick < ticks; ++tick) {
        if (tick % every == 0) {
            q_[0] += speed_radps * kTickS * every;
            bridge_->stream_j(q_);
        }
        if (step().is_faulted) break;
    }
    return state();
}

void Arm::direct_step(double speed_radps) {
    speed_radps_ = std::min(speed_radps, speed_radps_ + kQddMaxRadps2 * kTickS);
    q_[0] += speed_radps_ * kTickS;
    bridge_->direct_j(q_, joint_one(speed_radps_), {});
    step();
}

State Arm::direct(int ticks, double speed_radps) {
    q_ = state().q;
    bridge_->direct_j(q_, {}, {});
    step();
    for (int tick = 0; tick < ticks && !state().is_faulted; ++tick) direct_step(speed_radps);
    return state();
}

bool Arm::told(uint32_t condition) const {
    const State now = state();
    return std::any_of(now.events.begin(), now.events.begin() + now.event_count,
                       [condition](const auto& event) { return event.id == condition; });
}

Joints joint_one(double value) {
    Joints joints{};
    joints[0] = value;
    return joints;
}

bool is_refused(const char* kind, const std::function<void()>& command) {
    try {
        command();
    } catch (const station_kord::Refusal& refusal) {
        return std::strcmp(refusal.kind, kind) == 0;
    }
    return false;
}

}  // namespace tests
