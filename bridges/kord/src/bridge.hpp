// One arm: a thread that owns the session, and a face that any thread may call. See station_kord.KordBridge.
#pragma once

#include <atomic>
#include <condition_variable>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "arm_session.hpp"
#include "histogram.hpp"
#include "monotonic.hpp"
#include "motion.hpp"
#include "real_time.hpp"
#include "recovery.hpp"
#include "trace_ring.hpp"
#include "triple_buffer.hpp"

namespace station_kord {

class Bridge {
public:
    Bridge(BridgeConfig config, Hooks hooks);
    ~Bridge();
    Bridge(const Bridge&) = delete;
    Bridge& operator=(const Bridge&) = delete;

    void connect(double timeout_s);
    void close();
    State state() const;
    std::string real_time() const;
    std::vector<TraceRow> trace(int64_t rows) const { return trace_.last(rows); }
    void step(int64_t ticks);

    Joints engage();
    void disengage();
    void hold();
    void stream_j(const Joints& q);
    void velocity_j(const Joints& qd);
    void direct_j(const Joints& q, const Joints& qd, const Joints& qdd);
    void move_j(const Joints& q, double speed_radps);
    void move_l(const Pose& pose, double speed_mps);
    void set_profile(const Profile& profile);
    void set_throttle(int ticks);
    void clear_faults(double deadline_s);

private:
    // The face's, in bridge.cpp; `revoke` is the thread's too.
    State snapshot() const;
    bool is_engaged() const { return granted_.load() > revoked_.load(); }
    void revoke(uint64_t granted);
    void check_profile(const Profile& profile) const;
    void check_ready(const State& state, Mode wanted) const;
    void check_joints(const char* what, const Joints& values, const Joints& low, const Joints& high,
                      const char* unit) const;
    void check_speeds(const char* what, const Joints& qd) const;
    Wish wish_of(Mode kind) const;
    void post(Wish wish);
    void end();
    Outcome await_recovery(double deadline_s);

    // The thread's, in loop.cpp and telling.cpp. Nothing here calls Python, allocates in motion, logs, or waits for a
    // lock.
    void be_punctual();
    void run();
    bool open();
    void report(const std::string& problem);
    void tick();
    void lost_tick();
    void follow_engagement();
    Arm arm() const;
    void act(const Arm& arm);
    bool send(const Sending& sending);
    bool hand_over(const Sending& sending);
    void read();
    void note_fault(bool is_stopped);
    void note_events();
    void note(uint32_t id, uint32_t group);
    void lose();
    void recover();
    void publish();
    void remember(bool was_sent);
    int throttle() const {
        const int chosen = throttle_.load(std::memory_order_relaxed);
        return chosen > 0 ? chosen : profile_.throttle;
    }
    int64_t sends() const { return now_.stream_j_sends + now_.direct_sends + now_.move_sends; }
    bool winds_down();
    int64_t now_ns() const { return hooks_.now_ns ? hooks_.now_ns() : monotonic_ns(); }

    const BridgeConfig config_;
    const Limits limits_;
    const Hooks hooks_;

    std::thread thread_;
    std::mutex life_mutex_;  // connect and close
    std::atomic<bool> is_stopping_{false}, is_running_{false};

    mutable std::mutex readers_mutex_;  // among readers; the loop never takes it
    mutable TripleBuffer<State> told_;

    std::mutex writers_mutex_;  // among writers; the loop never takes it
    TripleBuffer<Wish> wishes_;
    Wish posted_;
    TripleBuffer<Profile> profiles_;
    std::atomic<int> throttle_{0};  // 0: the profile's own
    std::atomic<uint64_t> granted_{0}, revoked_{0};  // engagements; engaged is a grant that was not revoked

    std::atomic<int64_t> recovery_ticks_{0};  // > 0: begin
    std::atomic<uint32_t> recovery_number_{0};
    std::atomic<Outcome> recovery_outcome_{Outcome::cleared};

    mutable std::mutex report_mutex_;  // of the thread's beginning
    std::condition_variable reported_;
    bool has_reported_ = false;
    std::string problem_, real_time_;

    // From here on the thread's own.
    ArmSession session_;
    Motion motion_;
    Profile profile_;
    Recovery recovery_;
    MemoryLock memory_;
    TraceRing trace_;
    Histogram sync_to_send_, period_;
    State now_;
    uint64_t epoch_ = 0;
    int64_t opened_ns_ = 0, heard_ns_ = 0, returned_ns_ = 0, passed_ticks_ = 1, late_seen_ = 0, late_traced_ = 0;
    int silent_waits_ = 0, wind_down_ticks_ = 0;
    int64_t ticks_since_send_ = 0;
};

}  // namespace station_kord
