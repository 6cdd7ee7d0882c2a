// The calls to kord-api, and nothing else: what the loop wants said in one line each.
#pragma once

#include <memory>

#include <kord/api/kord.h>
#include <kord/api/kord_control_interface.h>
#include <kord/api/kord_receive_interface.h>

#include "types.hpp"

namespace station_kord {

// Bits of the controller's words that the bridge acts on.
constexpr uint32_t kHalt = 8, kSuspended = 32;
constexpr uint32_t kOffline = 64, kInit = 128, kReinit = 256, kBackdrive = 512, kPaused = 1024, kMaintenance = 2048;
constexpr uint32_t kNotReady = kOffline | kInit | kReinit | kBackdrive | kPaused | kMaintenance;  // others drive
constexpr uint32_t kCbunCategory = 4, kKordConditions = 3;  // of an alarm; of its condition, in thousands
constexpr uint32_t kStops = 2 | 4 | 8, kForPeople = 2 | 4 | 16;     // E, P, S stop; E, P stop and confirmation

struct Reading {
    Joints q{}, qd{}, qdd{}, torque{};
    Pose tcp{};
    uint32_t motion_flags = 0, safety_flags = 0, alarm = 0;
    int safety_mode = 0;
    double master_speed = 0;
    Insight insight;
    bool has_insight = false;

    bool is_stopped() const {
        return alarm != 0 || (motion_flags & (kHalt | kSuspended)) != 0 || (safety_flags & (kStops | kForPeople)) != 0;
    }
    bool is_ready() const { return (motion_flags & kNotReady) == 0; }
    bool is_kords() const { return (alarm & 0xf) == kCbunCategory || (alarm >> 8 & 0xfff) / 1000 == kKordConditions; }
    bool needs_user() const { return (safety_flags & kForPeople) != 0; }
};

class ArmSession {
public:
    // May allocate and block; never called in motion.
    bool open(const BridgeConfig& config);
    bool reopen();
    void close();

    // One tick's, in this order.
    bool wait();
    bool stream(const Joints& q, const Profile& profile);
    bool direct(const Joints& q, const Joints& qd, const Joints& qdd);
    bool move_joints(const Joints& q, double speed_radps);
    bool move_line(const Pose& pose, double speed_mps);
    bool stop(const Joints& q, double duration_s);
    int64_t clear(kr2::kord::ControlInterface::EClearRequest what);
    void fetch();

    const Reading& reading() const { return reading_; }
    int8_t status_of(int64_t token) { return receiver_->getCommandStatus(token); }
    std::vector<kr2::kord::protocol::SystemEvent> events() { return receiver_->getSystemEvents(); }

private:
    bool synchronise();

    std::shared_ptr<kr2::kord::KordCore> core_;
    std::unique_ptr<kr2::kord::ControlInterface> control_;
    std::unique_ptr<kr2::kord::ReceiverInterface> receiver_;
    Reading reading_;
};

}  // namespace station_kord
