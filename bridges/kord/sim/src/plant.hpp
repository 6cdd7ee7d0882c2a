// A controller, its clock, and all who have to do with it: one session, and whoever disturbs or watches it.
#pragma once

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <random>
#include <string>
#include <vector>

#include "controller.hpp"
#include "monotonic.hpp"
#include "trace_row.hpp"

namespace kordsim {

using station_kord::monotonic_ns;
using station_kord::TraceRow;

class Plant {
public:
    explicit Plant(const Options& options);

    const Options& options() const { return options_; }

    // A session within this process. `wait` is waitSync: it lets time pass until the next heartbeat.
    void open();
    void close();
    bool wait(std::chrono::microseconds timeout, Status& heard);
    bool receive(const Command& command);  // false where it did not leave the sender's machine
    void receive(const Clear& clear);
    Status look();

    // A session through a socket has its time from `tick`, which tells whether a heartbeat goes out.
    bool tick(int64_t time_ns, Status& told);
    void waited();

    // The virtual clock: let ticks pass and wait until the session has finished each; false where it runs free.
    bool step(int64_t ticks);
    void run_free(bool is_free);  // whether it stops nobody
    int64_t now_ns() const;

    void delay_commands(int count);
    void fail_sends(int count);
    void lose_commands(int count);
    void pause(bool is_paused);
    void emergency_stop(bool is_pressed);
    void confirm();
    void raise_event(uint32_t condition);
    void silence(bool is_silent);
    int64_t ticks();
    bool is_moving();
    std::vector<TraceRow> trace(int64_t rows);

private:
    bool wait_virtual(int64_t ticks, Status& heard);
    bool wait_wall(std::chrono::microseconds timeout, Status& heard);
    bool advance(int64_t time_ns, Status& told);
    void measure(Status& told);

    const Options options_;
    mutable std::mutex mutex_;
    Controller controller_;
    std::mt19937_64 noise_;
    bool is_silent_ = false;
    int failing_ = 0;
    std::vector<TraceRow> trace_;
    int64_t rows_ = 0;

    int64_t begun_ns_ = 0, passed_ = 0;  // the wall clock's

    std::condition_variable changed_;
    int64_t granted_ = 0;
    std::atomic<int64_t> virtual_ns_{0};
    bool is_free_ = false, is_waiting_ = false;
};

// Plants of this process by name, which is what a session has for a host.
std::string enroll(const std::shared_ptr<Plant>& plant);
std::shared_ptr<Plant> find(const std::string& name);

void sleep_until(int64_t instant_ns);

}  // namespace kordsim
