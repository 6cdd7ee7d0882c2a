#include "real_time.hpp"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>

#include <cerrno>
#include <cstring>
#include <mutex>

namespace station_kord {

namespace {

std::mutex holders_mutex;
int holders = 0;

}  // namespace

std::string request_fifo(int priority) {
    prctl(PR_SET_TIMERSLACK, 1UL, 0, 0, 0);  // wake at the instant, not up to 50 us after it
    sched_param wanted{};
    wanted.sched_priority = priority;
    const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);
    return error == 0 ? "" : std::strerror(error);
}

// Of the kernel: pthread_getschedparam answers with what the C library once set for a thread, and what it was asked for
// of a thread goes on to those that it starts, whatever the kernel does with either.
int fifo_priority() {
    sched_param has{};
    const int policy = sched_getscheduler(0);
    if (policy < 0 || (policy & ~SCHED_RESET_ON_FORK) != SCHED_FIFO || sched_getparam(0, &has) != 0) return 0;
    return has.sched_priority;
}

std::string MemoryLock::acquire() {
    const std::lock_guard lock(holders_mutex);
    if (is_held_) return "";
    if (holders == 0 && mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
        const std::string reason = std::strerror(errno);
        munlockall();  // a lock that failed half way
        return reason;
    }
    ++holders;
    is_held_ = true;
    return "";
}

void MemoryLock::release() {
    const std::lock_guard lock(holders_mutex);
    if (!is_held_) return;
    is_held_ = false;
    if (--holders == 0) munlockall();
}

}  // namespace station_kord
