// What the loop may not do: allocate in motion. Every allocation of the process is counted here.
#include <atomic>
#include <cstdlib>
#include <new>

#include "arm.hpp"
#include "check.hpp"
#include "histogram.hpp"
#include "triple_buffer.hpp"

static std::atomic<int64_t> allocations{0};

void* operator new(std::size_t size) {
    ++allocations;
    if (void* memory = std::malloc(size)) return memory;
    throw std::bad_alloc();
}

void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

using namespace tests;

TEST(the_loop_allocates_nothing_in_motion) {
    Arm arm;
    arm.stream(100);
    const int64_t before = allocations;
    arm.stream(1000);
    for (int tick = 0; tick < 100; ++tick) arm.bridge().step(1);
    for (int tick = 0; tick < 500; ++tick) {
        arm.bridge().velocity_j(joint_one(0.2));
        arm.bridge().step(1);
    }
    CHECK(arm.state().qd[0] > 0.19);
    CHECK(allocations == before);
}

TEST(a_triple_buffer_gives_the_newest_value_once) {
    station_kord::TripleBuffer<int> buffer;
    CHECK(!buffer.refresh());
    buffer.write(1);
    buffer.write(2);
    CHECK(buffer.refresh() && buffer.front() == 2);
    CHECK(!buffer.refresh() && buffer.front() == 2);
    buffer.write(3);
    CHECK(buffer.refresh() && buffer.front() == 3);
}

TEST(percentiles_are_those_of_what_was_added) {
    station_kord::Histogram histogram;
    for (int us = 1; us <= 1000; ++us) histogram.add(us);
    histogram.update();
    CHECK_NEAR(histogram.timing().p50, 500, 5);
    CHECK_NEAR(histogram.timing().p99, 990, 10);
    CHECK(histogram.timing().max == 1000 && histogram.timing().last == 1000);
}
