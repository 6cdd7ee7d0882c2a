#include "bridge.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>

#include "events.hpp"
#include "guard.hpp"

namespace station_kord {

namespace {

constexpr double kSeedRad = 0.0005;  // how far a first direct command may be from the arm
constexpr double kPollS = 0.002;
constexpr double kToolMaxMps = 2.0;  // of the tool, in the example of [MOTION_CONSTRAINTS] in KORD.ini
constexpr double kLeast = 1e-9;      // of what must be positive
constexpr int kLongestThrottle = 250;

std::string number(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.4g", value);
    return text;
}

Joints negative(Joints values) {
    for (double& value : values) value = -value;
    return values;
}

void check_throttle(const std::string& what, int ticks) {
    if (ticks < 1 || ticks > kLongestThrottle)
        throw Refusal("BadOption", what + ": 1 to 250 ticks of 4 ms are expected, not " + std::to_string(ticks));
}

void check_speed(const std::string& what, double speed, double most, const std::string& unit) {
    if (!(speed > 0 && speed <= most))
        throw Refusal("OutOfLimits", what + ": a speed of " + number(speed) + " " + unit + " is not above 0 and " +
                                         number(most) + " " + unit + " at most");
}

void check_taking(const std::string& what, const State& state) {
    const std::string why = not_ready_text(state.motion_flags);
    if (!why.empty())
        throw Refusal("Refused", what + ": the controller takes no commands (" + why + "); see its own display");
}

const char* name_of(Mode mode) {
    switch (mode) {
        case Mode::stream: return "stream_j";
        case Mode::velocity: return "velocity_j";
        case Mode::direct: return "direct_j";
        case Mode::move_joints: return "move_j";
        case Mode::move_line: return "move_l";
        case Mode::idle: break;
    }
    return "hold";
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
    is_stopping_ = true;
    thread_.join();
    const std::string where = config_.host + " port " + std::to_string(config_.port);
    throw Refusal("NotConnected", "no controller answered at " + where + " within " + number(timeout_s) + " s (" +
                                      (in_time ? problem_ : "it takes its time") +
                                      "); is it on, is its KORD CBun active, does this machine reach it?");
}

void Bridge::close() {
    const std::lock_guard life(life_mutex_);
    if (!thread_.joinable()) return;
    disengage();
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

Joints Bridge::engage() {
    const State now = snapshot();
    if (!now.is_connected) throw Refusal("NotConnected", "there is no session; connect first");
    if (now.is_faulted) throw Refusal("Refused", "the arm is faulted; clear the faults first");
    check_taking("engage", now);
    if (now.is_moving) throw Refusal("Refused", "the arm still moves; wait until it stands");
    granted_ = std::max(granted_.load(), revoked_.load()) + 1;
    return now.q;
}

void Bridge::disengage() { revoked_ = granted_.load(); }

void Bridge::hold() { post(Wish{}); }

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
    check_throttle(name + ": throttle", profile.throttle);
}

void Bridge::check_ready(const State& state, Mode wanted) const {
    const std::string what = name_of(wanted);
    if (!state.is_connected) throw Refusal("NotConnected", what + ": there is no session; connect first");
    if (state.is_faulted) throw Refusal("Refused", what + ": the arm is faulted; clear the faults, then engage");
    check_taking(what, state);
    if (!is_engaged()) throw Refusal("Refused", what + ": not engaged; engage first");
    const bool is_one_shot = wanted == Mode::move_joints || wanted == Mode::move_line;
    if (state.is_moving && (state.mode != wanted || is_one_shot) && state.mode != Mode::idle)
        throw Refusal("Refused", what + ": the arm still moves by " + name_of(state.mode) + "; wait until it stands");
}

void Bridge::check_joints(const char* what, const Joints& values, const Joints& low, const Joints& high,
                          const char* unit) const {
    const int joint = beyond(values, low, high);
    if (joint < 0) return;
    const auto at = static_cast<size_t>(joint);
    throw Refusal("OutOfLimits", std::string(what) + ": joint " + std::to_string(joint + 1) + " at " +
                                     number(values[at]) + " " + unit + " is outside " + number(low[at]) + " to " +
                                     number(high[at]) + " " + unit);
}

void Bridge::post(Wish wish) {
    const std::lock_guard lock(writers_mutex_);
    wish.epoch = granted_;
    const bool goes_on = wish.epoch == posted_.epoch;
    const bool is_same = goes_on && posted_.kind == Mode::stream && wish.q == posted_.q;
    wish.number = goes_on ? posted_.number : 0;
    if (wish.kind == Mode::stream && !is_same) ++wish.number;
    posted_ = wish;
    wishes_.write(wish);
}

void Bridge::stream_j(const Joints& q) {
    check_ready(snapshot(), Mode::stream);
    check_joints("stream_j", q, limits_.q_min, limits_.q_max, "rad");
    Wish wish;
    wish.kind = Mode::stream;
    wish.q = q;
    post(wish);
}

void Bridge::velocity_j(const Joints& qd) {
    check_ready(snapshot(), Mode::velocity);
    check_joints("velocity_j", qd, negative(limits_.qd_max), limits_.qd_max, "rad/s");
    Wish wish;
    wish.kind = Mode::velocity;
    wish.qd = qd;
    post(wish);
}

void Bridge::direct_j(const Joints& q, const Joints& qd, const Joints& qdd) {
    const State now = snapshot();
    check_ready(now, Mode::direct);
    check_joints("direct_j", q, limits_.q_min, limits_.q_max, "rad");
    check_joints("direct_j", qd, negative(limits_.qd_max), limits_.qd_max, "rad/s");
    check_joints("direct_j", qdd, negative(limits_.qdd_max), limits_.qdd_max, "rad/s²");
    for (size_t joint = 0; joint < kJoints && now.mode != Mode::direct; ++joint)
        if (std::abs(q[joint] - now.q[joint]) > kSeedRad)
            throw Refusal("Refused", "direct_j: the first command must be where the arm is; joint " +
                                         std::to_string(joint + 1) + " is at " + number(now.q[joint]) + " rad, not " +
                                         number(q[joint]));
    Wish wish;
    wish.kind = Mode::direct;
    wish.q = q;
    wish.qd = qd;
    wish.qdd = qdd;
    post(wish);
}

void Bridge::move_j(const Joints& q, double speed_radps) {
    check_ready(snapshot(), Mode::move_joints);
    check_joints("move_j", q, limits_.q_min, limits_.q_max, "rad");
    const double limit = *std::min_element(limits_.qd_max.begin(), limits_.qd_max.end());
    check_speed("move_j", speed_radps, limit, "rad/s");
    Wish wish;
    wish.kind = Mode::move_joints;
    wish.q = q;
    wish.speed = speed_radps;
    post(wish);
}

void Bridge::move_l(const Pose& pose, double speed_mps) {
    check_ready(snapshot(), Mode::move_line);
    if (!std::all_of(pose.begin(), pose.end(), [](double value) { return std::isfinite(value); }))
        throw Refusal("BadOption", "move_l: six finite numbers are needed, x y z roll pitch yaw");
    check_speed("move_l", speed_mps, kToolMaxMps, "m/s");
    Wish wish;
    wish.kind = Mode::move_line;
    wish.pose = pose;
    wish.speed = speed_mps;
    post(wish);
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
