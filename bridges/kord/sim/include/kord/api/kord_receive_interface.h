// Stand-in, see kord.h.
#pragma once

#include <kord/api/kord.h>

namespace kr2::kord {

class ReceiverInterface {
public:
    explicit ReceiverInterface(std::shared_ptr<kord::KordCore> kord);
    ~ReceiverInterface();

    void fetchData();
    bool fetchStatus();

    enum class EJointValue {
        T_REFERENCE_Q = 1,
        T_REFERENCE_QD = 2,
        T_REFERENCE_QDD = 3,
        T_REFERENCE_TRQ = 4,
        S_ACTUAL_Q = 5,
        S_ACTUAL_QD = 6,
        S_ACTUAL_QDD = 7,
        S_ACTUAL_TRQ = 8,
        S_TEMP_BOARD = 9,
        S_TEMP_JOINT_ENCODER = 10,
        S_TEMP_ROTOR_ENCODER = 11,
        S_SENSED_TRQ = 12
    };

    std::array<double, 7UL> getJoint(EJointValue value);
    std::array<double, 6UL> getTCP() const;
    unsigned int getMotionFlags() const;
    unsigned int getRobotSafetyFlags() const;
    int getSafetyMode() const;
    double getMasterSpeed() const;
    uint32_t systemAlarmState() const;
    std::vector<kr2::kord::protocol::SystemEvent> getSystemEvents();
    void clearSystemEventsBuffer();
    int8_t getCommandStatus(token_t token);

private:
    std::shared_ptr<KordCore> kord_;
};

}  // namespace kr2::kord
