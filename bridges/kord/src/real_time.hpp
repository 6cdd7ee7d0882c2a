// What a punctual thread asks of the system; none of it may fail the run.
#pragma once

#include <string>

namespace station_kord {

// Ask for SCHED_FIFO for the calling thread; empty where it was granted, otherwise the reason.
std::string request_fifo(int priority);

// The SCHED_FIFO priority that the kernel gives the calling thread, asked for or inherited; 0 for none.
int fifo_priority();

// Keep the process's memory from being swapped, until as many have given it back as asked for it.
class MemoryLock {
public:
    ~MemoryLock() { release(); }
    std::string acquire();
    void release();

private:
    bool is_held_ = false;
};

}  // namespace station_kord
