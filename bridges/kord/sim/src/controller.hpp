// The rules of the controller, one tick at a time; it knows no clock, no thread and no socket.
#pragma once

#include <vector>

#include "motion.hpp"
#include "planner.hpp"

namespace kordsim {

class Controller {
public:
    explicit Controller(const Options& options);
    Controller(const Controller&) = delete;
    Controller& operator=(const Controller&) = delete;

    // A session begins or ends. One that was lost by a fault stays lost until it is opened anew.
    void open();
    void close();
    void waited();  // waitSync was called

    void receive(const Command& command);
    void receive(const Clear& clear);

    void tick(int64_t time_ns);
    const Status& status() const { return status_; }
    void told() { status_.event_count = 0; }  // the status has gone out; an event is told once
    const Joints& goal() const { return motion_.goal(); }
    bool takes_commands() const { return !is_stopped() && (status_.motion_flags & kPaused) == 0; }
    bool is_stopped() const { return status_.alarm != 0 || (status_.motion_flags & (kHalt | kSuspended)) != 0; }
    int received_this_tick() const { return received_; }
    bool was_late_this_tick() const { return late_this_tick_; }

    void delay_commands(int count) { delayed_ = count; }
    void lose_commands(int count) { losing_ = count; }
    void press_emergency_stop(bool is_pressed);
    void confirm();
    void pause(bool is_paused);
    void fault(uint32_t condition);

private:
    struct Pending {
        Command command;
        int64_t due = 0;
    };

    struct Clearing {
        Clear request;
        int64_t due = 0;
    };

    bool is_late(const Command& command);
    void take_due();
    void take_direct(const std::vector<Command>& due);
    bool is_within_limits(const Joints& q) const;
    void watch();
    bool have_commands_ceased() const;
    void acknowledge(const Clear& request);
    int8_t clear(int32_t what);
    void resume_if_clear();
    void tell(uint32_t condition, uint32_t group);
    void publish(int64_t time_ns);

    Options options_;
    Planner planner_;
    Motion motion_;
    Status status_;
    std::vector<Pending> pending_;
    std::vector<Command> due_direct_;
    std::vector<Clearing> clearing_;
    int64_t tick_ = 0, ticks_since_move_ = 0;
    int delayed_ = 0, losing_ = 0, late_streak_ = 0, ticks_since_wait_ = 0, received_ = 0, acknowledged_next_ = 0;
    bool late_this_tick_ = false, is_pressed_ = false, has_cbun_event_ = false, has_session_ = false;
};

}  // namespace kordsim
