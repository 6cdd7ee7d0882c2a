#include "arm_session.hpp"

#include "backend.hpp"

namespace station_kord {

using namespace kr2::kord;

namespace {

constexpr std::chrono::microseconds kWait{8000};  // two ticks
constexpr double kStopBlendS = 0.008;             // as in the vendor's pattern for streams

}  // namespace

bool ArmSession::open(const BridgeConfig& config) {
    close();
    core_ = std::make_shared<KordCore>(config.host, static_cast<unsigned>(config.port),
                                       static_cast<unsigned>(config.session_id), UDP_CLIENT);
    control_ = std::make_unique<ControlInterface>(core_);  // kord-api wants both before it connects
    receiver_ = std::make_unique<ReceiverInterface>(core_);
    return synchronise();
}

bool ArmSession::reopen() {
    core_->disconnect();
    return synchronise();
}

bool ArmSession::synchronise() {
    if (!core_->connect() || !core_->syncRC()) return false;
    fetch();
    return true;
}

void ArmSession::close() {
    receiver_.reset();
    control_.reset();
    if (core_) core_->disconnect();
    core_.reset();
}

bool ArmSession::wait() { return core_->waitSync(kWait); }

bool ArmSession::stream(const Joints& q, const Profile& profile) {
    return control_->moveJ(q, profile.tracks_time ? TT_TIME : TT_JS_TARGET_SPEED, profile.tracking_value,
                           profile.blends ? BT_TIME : BT_NONE, profile.blend_s,
                           profile.stops_at_points ? OT_STOPPOINT : OT_VIAPOINT);
}

bool ArmSession::direct(const Joints& q, const Joints& qd, const Joints& qdd) {
    return control_->directJControl(q, qd, qdd);
}

bool ArmSession::move_joints(const Joints& q, double speed_radps) {
    return control_->moveJ(q, TT_JS_TARGET_SPEED, speed_radps, BT_NONE, 0.0, OT_STOPPOINT);
}

bool ArmSession::move_line(const Pose& pose, double speed_mps) {
    return control_->moveL(pose, TT_WS_TARGET_SPEED, speed_mps, BT_NONE, 0.0, OT_STOPPOINT);
}

// In place of the move that runs, as a newer target of a stream is.
bool ArmSession::stop(const Joints& q, double duration_s) {
    return control_->moveJ(q, TT_TIME, duration_s, BT_TIME, kStopBlendS, OT_VIAPOINT);
}

int64_t ArmSession::clear(ControlInterface::EClearRequest what) { return control_->clearAlarmRequest(what); }

void ArmSession::fetch() {
    using Value = ReceiverInterface::EJointValue;
    receiver_->fetchData();
    reading_.q = receiver_->getJoint(Value::S_ACTUAL_Q);
    reading_.qd = receiver_->getJoint(Value::S_ACTUAL_QD);
    reading_.qdd = receiver_->getJoint(Value::S_ACTUAL_QDD);
    reading_.torque = receiver_->getJoint(Value::S_ACTUAL_TRQ);
    reading_.tcp = receiver_->getTCP();
    reading_.motion_flags = receiver_->getMotionFlags();
    reading_.safety_flags = receiver_->getRobotSafetyFlags();
    reading_.safety_mode = receiver_->getSafetyMode();
    reading_.master_speed = receiver_->getMasterSpeed();
    reading_.alarm = receiver_->systemAlarmState();
    reading_.has_insight = look_inside(*core_, reading_.insight);
}

}  // namespace station_kord
