// The names of kord-api, done by a simulated session.
#include <kord/api/kord.h>
#include <kord/api/kord_control_interface.h>
#include <kord/api/kord_receive_interface.h>

#include "session.hpp"

namespace kr2::kord {

namespace {

kordsim::Tracking tracking_of(TrackingType type) {
    if (type == TT_JS_TARGET_SPEED) return kordsim::Tracking::joint_speed;
    return type == TT_WS_TARGET_SPEED ? kordsim::Tracking::tool_speed : kordsim::Tracking::time;
}

kordsim::Command move(kordsim::CommandKind kind, TrackingType tt, double tt_value, BlendType bt, double bt_value,
                      OverlayType ot) {
    kordsim::Command command;
    command.kind = kind;
    command.tracking = tracking_of(tt);
    command.tracking_value = tt_value;
    command.blend_s = bt == BT_TIME ? bt_value : 0.0;
    command.stops_at_point = ot != OT_VIAPOINT;
    return command;
}

}  // namespace

KordCore::KordCore(const std::string& hostname, unsigned int, unsigned int, connection)
    : session_(std::make_unique<kordsim::Session>(hostname)) {}

KordCore::~KordCore() = default;

bool KordCore::connect(const char*) { return session_->open(); }

bool KordCore::disconnect() {
    session_->close();
    return true;
}

bool KordCore::syncRC(long) { return session_->sync(); }

bool KordCore::waitSync(std::chrono::microseconds timeout, long) { return session_->wait(timeout); }

void KordCore::spin() { session_->wait(std::chrono::microseconds(4000)); }

ControlInterface::ControlInterface(std::shared_ptr<kord::KordCore> kord) : kord_(std::move(kord)) {}

ControlInterface::~ControlInterface() { kord_->disconnect(); }

bool ControlInterface::moveJ(const std::array<double, 7UL>& q, const TrackingType& tt, const double& tt_value,
                             const BlendType& bt, const double& bt_value, const OverlayType& ot, const double&) {
    auto command = move(kordsim::CommandKind::move_joints, tt, tt_value, bt, bt_value, ot);
    command.q = q;
    return kord_->session().send(command);
}

bool ControlInterface::moveL(const std::array<double, 6UL>& pose, const TrackingType& tt, const double& tt_value,
                             const BlendType& bt, const double& bt_value, const OverlayType& ot, const double&) {
    auto command = move(kordsim::CommandKind::move_line, tt, tt_value, bt, bt_value, ot);
    for (size_t i = 0; i < pose.size(); ++i) command.q[i] = pose[i];
    return kord_->session().send(command);
}

bool ControlInterface::directJControl(const std::array<double, 7UL>& q, const std::array<double, 7UL>& qd,
                                      const std::array<double, 7UL>&) {
    kordsim::Command command;
    command.kind = kordsim::CommandKind::direct;
    command.q = q;
    command.qd = qd;
    return kord_->session().send(command);
}

bool ControlInterface::directJControl(const std::array<double, 7UL>& q, const std::array<double, 7UL>& qd,
                                      const std::array<double, 7UL>& qdd, const std::array<double, 7UL>&) {
    return directJControl(q, qd, qdd);
}

int64_t ControlInterface::clearAlarmRequest(EClearRequest alarm_request) {
    return kord_->session().send_clear(static_cast<int32_t>(alarm_request));
}

ReceiverInterface::ReceiverInterface(std::shared_ptr<kord::KordCore> kord) : kord_(std::move(kord)) {}

ReceiverInterface::~ReceiverInterface() = default;

void ReceiverInterface::fetchData() { kord_->session().fetch(); }

bool ReceiverInterface::fetchStatus() {
    if (!kord_->waitSync()) return false;
    fetchData();
    return true;
}

std::array<double, 7UL> ReceiverInterface::getJoint(EJointValue value) {
    const kordsim::Status& status = kord_->session().fetched();
    switch (value) {
        case EJointValue::T_REFERENCE_Q:
        case EJointValue::S_ACTUAL_Q: return status.q;
        case EJointValue::T_REFERENCE_QD:
        case EJointValue::S_ACTUAL_QD: return status.qd;
        case EJointValue::T_REFERENCE_QDD:
        case EJointValue::S_ACTUAL_QDD: return status.qdd;
        case EJointValue::T_REFERENCE_TRQ:
        case EJointValue::S_ACTUAL_TRQ:
        case EJointValue::S_SENSED_TRQ: return status.torque;
        default: return {30, 30, 30, 30, 30, 30, 30};  // [°C]
    }
}

std::array<double, 6UL> ReceiverInterface::getTCP() const { return kord_->session().fetched().tcp; }

unsigned int ReceiverInterface::getMotionFlags() const { return kord_->session().fetched().motion_flags; }

unsigned int ReceiverInterface::getRobotSafetyFlags() const { return kord_->session().fetched().safety_flags; }

int ReceiverInterface::getSafetyMode() const { return kord_->session().fetched().safety_mode; }

double ReceiverInterface::getMasterSpeed() const { return kord_->session().fetched().master_speed; }

uint32_t ReceiverInterface::systemAlarmState() const { return kord_->session().fetched().alarm; }

std::vector<kr2::kord::protocol::SystemEvent> ReceiverInterface::getSystemEvents() {
    const kordsim::Status& status = kord_->session().heard();
    std::vector<kr2::kord::protocol::SystemEvent> events;
    for (int i = 0; i < status.event_count; ++i) {
        const auto& told = status.events[static_cast<size_t>(i)];
        events.push_back({told.time_ns, told.id, static_cast<uint16_t>(told.group)});
    }
    return events;
}

void ReceiverInterface::clearSystemEventsBuffer() {}

int8_t ReceiverInterface::getCommandStatus(token_t token) {
    for (const auto& told : kord_->session().fetched().acknowledged)
        if (told.token == token && token != 0) return static_cast<int8_t>(told.code);
    return -1;
}

}  // namespace kr2::kord
