#include "bridge.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>

#include "events.hpp"

namespace station_kord {

namespace {

constexpr double kPollS = 0.002;
constexpr double kLeast = 1e-9;      // of what must be positive
constexpr int kLongestThrottle = 250;

void check_throttle(const std::string& what, int ticks) {
    if (ticks < 1 || ticks > kLongestThrottle)
        throw Refusal("BadOption", what + ": 1 to 250 ticks of 4 ms are expected, not " + std::to_string(ticks));
}

}  // namespace

Bridge::Bridge(BridgeConfig config, Hooks hooks)
    : config_(std::move(config)), limits_{config_.q_min, config_.q_max, config_.qd_max, config_.qdd_max},
      hooks_(std::move(hooks)), motion_(limits_, config_.resend_targets), profile_(config_.profile),
      trace_(config_.trace_ticks) {
    check_profile(profile_);
}

Bridge::~Bridge() { close(); }

void Bridge::connect(double timeout_s) {
    close();
    const std::lock_guard life(life_mutex_);
    is_stopping_ = has_reported_ = false;
    if (hooks_.run_free) hooks_.run_free(false);
    is_running_ = true;
    thread_ = std::thread([this] { run(); });
    std::unique_lock lock(report_mutex_);
    const bool in_time =
        reported_.wait_for(lock, std::chrono::duration<double>(timeout_s), [this] { return has_reported_; });
    if (in_time && problem_.empty()) return;
    lock.unlock();
    end();
    const std::string where = config_.host + " port " + std::to_string(config_.port);
    throw Refusal("NotConnected", "no controller answered at " + where + " within " + number(timeout_s) + " s (" +
                                      (in_time ? problem_ : "it takes its time") +
                                      "); is it on, is its KORD CBun active, does this machine reach it?");
}

void Bridge::close() {
    const std::lock_guard life(life_mutex_);
    if (!thread_.joinable()) return;
    disengage();
    end();
}

void Bridge::end() {
    is_stopping_ = true;
    if (hooks_.run_free) hooks_.run_free(true);
    thread_.join();
}

State Bridge::snapshot() const {
    const std::lock_guard lock(readers_mutex_);
    told_.refresh();
    return told_.front();
}

State Bridge::state() const {
    State state = snapshot();
    state.is_engaged = is_engaged() && state.is_connected && !state.is_faulted;
    return state;
}

std::string Bridge::real_time() const {
    const std::lock_guard lock(report_mutex_);
    return real_time_;
}

void Bridge::step(int64_t ticks) {
    if (!hooks_.step) throw Refusal("Refused", "only a virtual clock can be stepped; this one is the wall clock");
    if (!is_running_ || !hooks_.step(ticks)) throw Refusal("NotConnected", "there is no session to step; connect first");
}

void Bridge::check_profile(const Profile& profile) const {
    const std::string name = std::string("profile '") + profile.name.data() + "'";
    if (profile.sim_only && !config_.is_simulated) throw Refusal("Refused", name + " is for the simulator only");
    const auto is_within = [](double value, double low) { return std::isfinite(value) && value >= low; };
    if (!is_within(profile.tracking_value, kLeast) || !is_within(profile.blend_s, 0.0))
        throw Refusal("BadOption", name + ": tracking_value must be positive, blend_s not negative, both finite; not " +
                                       number(profile.tracking_value) + " and " + number(profile.blend_s));
    if (profile.offset_guard && !is_within(profile.guard_qdd_radps2, kLeast))
        throw Refusal("BadOption", name + ": guard_qdd_radps2 must be positive and finite with an offset guard, not " +
                                       number(profile.guard_qdd_radps2));
    const double fastest = *std::min_element(limits_.qd_max.begin(), limits_.qd_max.end());
    if (!profile.tracks_time && profile.tracking_value > fastest)
        throw Refusal("BadOption", name + ": tracking_value must be a speed of " + number(fastest) +
                                       " rad/s at most, as the limits of the joints have it, not " +
                                       number(profile.tracking_value));
    check_throttle(name + ": throttle", profile.throttle);
}

void Bridge::set_profile(const Profile& profile) {
    check_profile(profile);
    if (snapshot().is_moving) throw Refusal("Refused", "profiles change at standstill only, and the arm moves");
    const std::lock_guard lock(writers_mutex_);
    profiles_.write(profile);
    throttle_ = 0;
}

void Bridge::set_throttle(int ticks) {
    check_throttle("throttle", ticks);
    throttle_ = ticks;
}

void Bridge::clear_faults(double deadline_s) {
    if (!is_running_) throw Refusal("NotConnected", "there is no session; connect first");
    disengage();
    switch (await_recovery(deadline_s)) {
        case Outcome::cleared: return;
        case Outcome::needs_user:
            throw Refusal("Refused", "only a person at the controller can clear this; release what stopped it and "
                                     "confirm there");
        case Outcome::refused:
            throw Refusal("Refused", "the controller refused to clear its alarm; look at its own display");
        case Outcome::no_answer:
            throw Refusal("NotConnected", "the controller does not answer; is it on and reachable?");
        default:
            throw Refusal("Refused", "the alarm was not cleared within " + number(deadline_s) +
                                         " s; look at the controller's own display");
    }
}

Outcome Bridge::await_recovery(double deadline_s) {
    const uint32_t before = recovery_number_;
    const auto ticks = std::max<int64_t>(1, static_cast<int64_t>(deadline_s / kTickS));
    recovery_ticks_ = ticks;
    const int64_t until_ns = monotonic_ns() + static_cast<int64_t>((deadline_s + 1.0) * 1e9);
    while (recovery_number_ == before && is_running_) {
        if (hooks_.step) {
            if (!hooks_.step(1)) return Outcome::no_answer;
        } else if (monotonic_ns() > until_ns) {
            return Outcome::too_late;
        } else {
            std::this_thread::sleep_for(std::chrono::duration<double>(kPollS));
        }
    }
    return is_running_ || recovery_number_ != before ? recovery_outcome_.load() : Outcome::no_answer;
}

}  // namespace station_kord
