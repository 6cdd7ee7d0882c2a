// A plant with a socket: sessions of other processes come and go, time goes on.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <thread>

#include "plant.hpp"

namespace kordsim {

class Server {
public:
    // A priority above 0 is asked for under SCHED_FIFO; where it is not granted, heartbeats are less punctual.
    Server(std::string path, std::shared_ptr<Plant> plant, int real_time_priority);
    ~Server();

    // Empty where it listens now, otherwise what is in the way.
    std::string start();
    void stop();
    bool has_client() const { return has_client_; }

private:
    std::string listen();
    void run();
    void admit();
    void hear();
    void part();

    const std::string path_;
    const std::shared_ptr<Plant> plant_;
    const int real_time_priority_;
    std::thread thread_;
    std::atomic<bool> is_stopping_{false}, has_client_{false};
    int listener_ = -1, client_ = -1, wake_[2] = {-1, -1};
};

}  // namespace kordsim
