#include "plant.hpp"

#include <algorithm>
#include <cstring>
#include <ctime>
#include <map>

namespace kordsim {

namespace {

constexpr size_t kTraceRows = 15'000;  // one minute
constexpr int64_t kAtOnce = 256;       // rows copied while the controller waits

TraceRow row_of(const Controller& controller) {
    const Status& status = controller.status();
    TraceRow row;
    row.tick = status.tick;
    std::memcpy(row.q, status.q.data(), sizeof row.q);
    std::memcpy(row.qd, status.qd.data(), sizeof row.qd);
    std::memcpy(row.q_target, controller.goal().data(), sizeof row.q_target);
    std::memcpy(row.q_sent, controller.goal().data(), sizeof row.q_sent);
    row.queued_motion_s = status.queued_motion_s;
    row.planner_backlog = status.planner_backlog;
    row.moving = (status.motion_flags & kTracking) != 0;
    row.fault = controller.is_stopped();
    return row;
}

}  // namespace

void sleep_until(int64_t instant_ns) {
    const timespec until{instant_ns / 1'000'000'000LL, instant_ns % 1'000'000'000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) != 0) {
    }
}

Plant::Plant(const Options& options)
    : options_(options), controller_(options), noise_(options.noise_seed), trace_(kTraceRows) {}

void Plant::open() {
    const std::lock_guard lock(mutex_);
    controller_.open();
    begun_ns_ = monotonic_ns();
    passed_ = 0;
}

void Plant::close() {
    const std::lock_guard lock(mutex_);
    controller_.close();
}

bool Plant::wait(std::chrono::microseconds timeout, Status& heard) {
    if (!options_.is_virtual) return wait_wall(timeout, heard);
    return wait_virtual(std::max<int64_t>(1, timeout.count() / 4000), heard);
}

bool Plant::wait_virtual(int64_t ticks, Status& heard) {
    std::unique_lock lock(mutex_);
    controller_.waited();
    for (int64_t tick = 0; tick < ticks; ++tick) {
        is_waiting_ = true;
        changed_.notify_all();
        changed_.wait(lock, [&] { return granted_ > 0 || is_free_; });
        is_waiting_ = false;
        if (granted_ > 0) --granted_;
        virtual_ns_ += kTickNs;
        if (advance(virtual_ns_, heard)) return true;
    }
    return false;
}

bool Plant::wait_wall(std::chrono::microseconds timeout, Status& heard) {
    const int64_t called_ns = monotonic_ns();
    std::unique_lock lock(mutex_);
    controller_.waited();
    const int64_t elapsed = (called_ns - begun_ns_) / kTickNs;
    const int64_t next = std::max(passed_, elapsed) + 1;  // heartbeats that passed meanwhile are lost
    bool was_told = false;
    while (passed_ < next) {
        const int64_t instant_ns = begun_ns_ + (passed_ + 1) * kTickNs;
        lock.unlock();
        if (instant_ns > called_ns) sleep_until(instant_ns);
        lock.lock();
        ++passed_;
        was_told = advance(instant_ns, heard);
    }
    lock.unlock();
    if (!was_told) sleep_until(called_ns + timeout.count() * 1000);
    return was_told;
}

bool Plant::advance(int64_t time_ns, Status& told) {
    const bool was_lost = controller_.status().is_lost;
    if (rows_ > 0) {
        TraceRow& row = trace_[static_cast<size_t>(rows_ - 1) % trace_.size()];
        row.sent = static_cast<uint8_t>(controller_.received_this_tick());
        row.late = controller_.was_late_this_tick();
    }
    controller_.tick(time_ns);
    trace_[static_cast<size_t>(rows_++) % trace_.size()] = row_of(controller_);
    const bool says_why = controller_.status().event_count > 0;  // the last heartbeat of a session that is lost
    if (is_silent_ || (was_lost && !says_why)) return false;
    told = controller_.status();
    measure(told);
    controller_.told();
    return true;
}

// Sensors; the trace has what is so. The same seed gives the same noise with every compiler.
void Plant::measure(Status& told) {
    if (options_.speed_noise_radps == 0) return;
    for (double& speed : told.qd) {
        const double share = static_cast<double>(noise_() >> 11) * 0x1p-53;  // 0 to 1
        speed += options_.speed_noise_radps * (2 * share - 1);
    }
}

bool Plant::receive(const Command& command) {
    const std::lock_guard lock(mutex_);
    if (failing_ > 0) {
        --failing_;
        return false;
    }
    controller_.receive(command);
    return true;
}

void Plant::receive(const Clear& clear) {
    const std::lock_guard lock(mutex_);
    controller_.receive(clear);
}

Status Plant::look() {
    const std::lock_guard lock(mutex_);
    return controller_.status();
}

bool Plant::tick(int64_t time_ns, Status& told) {
    const std::lock_guard lock(mutex_);
    return advance(time_ns, told);
}

void Plant::waited() {
    const std::lock_guard lock(mutex_);
    controller_.waited();
}

bool Plant::step(int64_t ticks) {
    std::unique_lock lock(mutex_);
    if (is_free_) return false;
    granted_ += ticks;
    changed_.notify_all();
    changed_.wait(lock, [&] { return is_free_ || (granted_ == 0 && is_waiting_); });
    return !is_free_;
}

void Plant::run_free(bool is_free) {
    const std::lock_guard lock(mutex_);
    is_free_ = is_free;
    granted_ = 0;
    changed_.notify_all();
}

int64_t Plant::now_ns() const { return options_.is_virtual ? virtual_ns_.load() : monotonic_ns(); }

void Plant::delay_commands(int count) {
    const std::lock_guard lock(mutex_);
    controller_.delay_commands(count);
}

void Plant::fail_sends(int count) {
    const std::lock_guard lock(mutex_);
    failing_ = count;
}

void Plant::lose_commands(int count) {
    const std::lock_guard lock(mutex_);
    controller_.lose_commands(count);
}

void Plant::pause(bool is_paused) {
    const std::lock_guard lock(mutex_);
    controller_.pause(is_paused);
}

void Plant::emergency_stop(bool is_pressed) {
    const std::lock_guard lock(mutex_);
    controller_.press_emergency_stop(is_pressed);
}

void Plant::confirm() {
    const std::lock_guard lock(mutex_);
    controller_.confirm();
}

void Plant::raise_event(uint32_t condition) {
    const std::lock_guard lock(mutex_);
    controller_.fault(condition);
}

void Plant::silence(bool is_silent) {
    const std::lock_guard lock(mutex_);
    is_silent_ = is_silent;
}

int64_t Plant::ticks() {
    const std::lock_guard lock(mutex_);
    return controller_.status().tick;
}

bool Plant::is_moving() {
    const std::lock_guard lock(mutex_);
    return (controller_.status().motion_flags & kTracking) != 0;
}

std::vector<TraceRow> Plant::trace(int64_t rows) {
    std::vector<TraceRow> out;
    std::unique_lock lock(mutex_);
    const auto length = static_cast<int64_t>(trace_.size());
    const int64_t end = rows_, held = std::min(end, length);
    int64_t row = end - (rows < 0 ? held : std::min(rows, held));
    out.reserve(static_cast<size_t>(end - row));
    while (row < end) {
        for (const int64_t stop = std::min(end, row + kAtOnce); row < stop; ++row)
            if (rows_ - row <= length) out.push_back(trace_[static_cast<size_t>(row % length)]);
        lock.unlock();
        lock.lock();
    }
    return out;
}

namespace {

std::mutex enrolled_mutex;

std::map<std::string, std::weak_ptr<Plant>>& enrolled() {
    static std::map<std::string, std::weak_ptr<Plant>> plants;
    return plants;
}

}  // namespace

std::string enroll(const std::shared_ptr<Plant>& plant) {
    static int64_t number = 0;
    const std::lock_guard lock(enrolled_mutex);
    auto& plants = enrolled();
    for (auto it = plants.begin(); it != plants.end();) it = it->second.expired() ? plants.erase(it) : std::next(it);
    const std::string name = "sim:" + std::to_string(++number);
    plants[name] = plant;
    return name;
}

std::shared_ptr<Plant> find(const std::string& name) {
    const std::lock_guard lock(enrolled_mutex);
    const auto found = enrolled().find(name);
    return found == enrolled().end() ? nullptr : found->second.lock();
}

}  // namespace kordsim
