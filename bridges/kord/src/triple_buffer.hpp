// The newest value from one thread to another, and neither ever waits: three slots, one each and one between them.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace station_kord {

// One writer and one reader at a time. That a value is new and the value itself change hands in one exchange, so none
// that was written is lost or torn, except to a newer one.
template <typename Value>
class TripleBuffer {
public:
    // The writer's.
    void write(const Value& value) {
        slots_[back_] = value;
        back_ = between_.exchange(back_ | kNew, std::memory_order_acq_rel) & kSlot;
    }

    // The reader's: true where there is a newer value than at the last call.
    bool refresh() {
        if ((between_.load(std::memory_order_relaxed) & kNew) == 0) return false;
        front_ = between_.exchange(front_, std::memory_order_acq_rel) & kSlot;
        return true;
    }

    const Value& front() const { return slots_[front_]; }

private:
    static constexpr uint32_t kSlot = 3, kNew = 4;

    std::array<Value, 3> slots_{};
    std::atomic<uint32_t> between_{1};
    uint32_t back_ = 0, front_ = 2;
};

}  // namespace station_kord
