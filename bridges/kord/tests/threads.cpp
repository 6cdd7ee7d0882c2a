// K12, K13, K14, and a controller behind a socket: where threads and processes meet.
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <thread>
#include <vector>

#include "arm.hpp"
#include "check.hpp"
#include "server.hpp"

using namespace tests;

namespace {

constexpr auto kPatience = std::chrono::seconds(60);

void await(const char* what, const std::function<bool()>& condition) {
    const auto until = std::chrono::steady_clock::now() + kPatience;
    while (!condition()) {
        if (std::chrono::steady_clock::now() > until) checks::fail(__FILE__, __LINE__, what);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
}

// A thread beside the test's own, which ends however the test does.
class Beside {
public:
    explicit Beside(std::function<void()> turn)
        : thread_([this, turn = std::move(turn)] {
              while (!stops_) turn();
          }) {}
    ~Beside() { end(); }
    void end() {
        stops_ = true;
        if (thread_.joinable()) thread_.join();
    }

private:
    std::atomic<bool> stops_{false};
    std::thread thread_;  // last: it looks at the other
};

// A sanitizer is slow; what that does to punctuality is not what these tests are about.
void be_patient(Setup& setup) {
    setup.options.window_us = 1e6;
    setup.options.watchdog_ticks = 1'000'000;
}

// A controller behind a socket.
class Apart {
public:
    Apart() : plant(std::make_shared<kordsim::Plant>(options())), server(made_folder() + "/s", plant, 0) {
        CHECK(server.start().empty());
    }
    ~Apart() {
        server.stop();
        rmdir(folder_);
    }

    station_kord::BridgeConfig config() const {
        station_kord::BridgeConfig config;
        config.host = "unix:" + std::string(folder_) + "/s";
        config.q_min = plant->options().q_min;
        config.q_max = plant->options().q_max;
        config.qd_max.fill(2.0);
        config.qdd_max.fill(10.0);
        config.profile = speed125();
        config.is_simulated = true;
        return config;
    }

private:
    static kordsim::Options options() {
        kordsim::Options options;
        options.window_us = 1e6;
        return options;
    }

    std::string made_folder() {
        CHECK(mkdtemp(folder_) != nullptr);
        return folder_;
    }

    char folder_[16] = "/tmp/kordXXXXXX";

public:
    const std::shared_ptr<kordsim::Plant> plant;
    kordsim::Server server;
};

}  // namespace

TEST(k12_the_loop_keeps_its_rate_and_sends_at_once_on_the_wall_clock) {
    Setup setup;
    setup.is_virtual = false;
    setup.real_time_priority = 70;
    be_patient(setup);
    Arm arm(setup);
    const Joints begin = arm.state().q;
    State before = arm.state();
    std::vector<double> rates;
    await("250 Hz within 2 %, and half of the commands within 100 us", [&] {
        const State now = arm.state();
        Joints q = begin;
        q[0] += 0.05 * std::sin(static_cast<double>(now.tick) * 0.02);
        arm.bridge().stream_j(q);
        if (now.tick - before.tick < 250) return false;
        const double seconds = static_cast<double>(now.mono_ns - before.mono_ns) * 1e-9;
        rates.push_back(static_cast<double>(now.tick - before.tick) / seconds);
        before = now;
        std::sort(rates.begin(), rates.end());
        const double median = rates[rates.size() / 2];
        const bool is_punctual = std::abs(median - 250) < 5 && now.sync_to_send_us.p50 < 100;
        return rates.size() >= 5 && is_punctual && now.stream_j_sends > 500;
    });
    CHECK(arm.state().event_count == 0);
}

TEST(k13_targets_of_another_thread_are_never_mixed) {
    Setup setup;
    setup.profile = time250();
    setup.options.buffer_len = 100'000;
    Arm arm(setup);
    std::atomic<int> torn{0};
    Beside writer([&arm, number = int64_t{0}]() mutable {
        Joints q{};
        for (size_t joint = 0; joint < q.size(); ++joint)
            q[joint] = 1e-6 * static_cast<double>(number % 1000) + 1e-4 * static_cast<double>(joint);
        ++number;
        arm.bridge().stream_j(q);
    });
    Beside reader([&] {
        const State state = arm.state();
        torn += state.mono_ns != state.tick * 4'000'000;
    });
    int different = 0;
    double last = -1;
    const auto until = std::chrono::steady_clock::now() + kPatience;
    while (different < 500 && std::chrono::steady_clock::now() < until) {
        const State state = arm.step();
        if (state.stream_j_sends == 0) continue;
        different += state.q_sent[0] != last;
        last = state.q_sent[0];
        for (size_t joint = 1; joint < state.q_sent.size(); ++joint)
            CHECK_NEAR(state.q_sent[joint] - state.q_sent[0], 1e-4 * static_cast<double>(joint), 1e-12);
    }
    writer.end();
    reader.end();
    CHECK(different >= 500 && torn == 0 && arm.state().event_count == 0);
}

TEST(k13_all_that_may_be_called_from_any_thread_is) {
    Setup setup;
    setup.is_virtual = false;
    be_patient(setup);
    Arm arm(setup);
    Beside others([&arm] {
        arm.bridge().set_throttle(2);
        arm.bridge().hold();
        arm.bridge().trace(50);
        arm.bridge().real_time();
        arm.plant().trace(50);
        arm.plant().ticks();
    });
    Joints q = arm.state().q;
    const int64_t until = arm.state().tick + 250;
    await("ticks", [&] {
        q[0] += 1e-5;
        arm.bridge().stream_j(q);
        return arm.state().tick > until;
    });
    others.end();
    arm.bridge().disengage();
    arm.bridge().close();
}

TEST(k14_what_is_not_granted_is_told) {
    const rlimit none{0, 0};
    setrlimit(RLIMIT_RTPRIO, &none);
    Setup setup;
    setup.is_virtual = false;
    setup.real_time_priority = 99;
    Arm arm(setup);
    const std::string told = arm.bridge().real_time();
    CHECK(arm.state().sched_fifo_granted == (told.rfind("SCHED_FIFO", 0) == 0));
    CHECK(geteuid() == 0 || told.rfind("normal scheduling (", 0) == 0);
    const int64_t tick = arm.state().tick;
    await("ticks", [&] { return arm.state().tick > tick + 20; });
}

TEST(a_session_through_a_socket_that_ends_in_motion_leaves_the_arm_at_rest) {
    Apart apart;
    auto& plant = apart.plant;
    {
        Bridge bridge(apart.config(), {});
        bridge.connect(10.0);
        Joints q = bridge.engage();
        q[0] += 1.0;
        bridge.move_j(q, 0.2);
        await("motion", [&] {
            const auto rows = plant->trace(50);
            return std::any_of(rows.begin(), rows.end(), [](const auto& row) { return row.qd[0] > 0.01; });
        });
    }
    const int64_t gone = plant->ticks();
    await("rest", [&] { return !plant->is_moving(); });
    int64_t last = gone;
    for (const auto& row : plant->trace(-1))
        if (row.qd[0] != 0) last = row.tick;
    CHECK(last - gone <= 50);
}

TEST(a_loop_whose_controller_is_gone_for_good_does_not_run_away) {
    Apart apart;
    Bridge bridge(apart.config(), {});
    bridge.connect(10.0);
    apart.server.stop();
    await("a lost session", [&] { return !bridge.state().is_connected; });
    CHECK(is_refused("NotConnected", [&] { bridge.clear_faults(5.0); }));
    const auto begun = std::chrono::steady_clock::now();
    const int64_t before = bridge.state().sync_timeouts;
    await("waits", [&] { return bridge.state().sync_timeouts > before + 20; });
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - begun;
    CHECK(took.count() > 20 * kTickS);
}
