// Stand-in, see kord.h.
#pragma once

#include <limits>

#include <kord/api/kord.h>

namespace kr2::kord {

class ControlInterface {
public:
    explicit ControlInterface(std::shared_ptr<kord::KordCore> kord);
    ~ControlInterface();

    bool moveJ(const std::array<double, 7UL>& q, const TrackingType& tt, const double& tt_value, const BlendType& bt,
               const double& bt_value, const OverlayType& ot,
               const double& sync_time = std::numeric_limits<double>::infinity());

    bool moveL(const std::array<double, 6UL>& pose, const TrackingType& tt, const double& tt_value,
               const BlendType& bt, const double& bt_value, const OverlayType& ot,
               const double& sync_time = std::numeric_limits<double>::infinity());

    bool directJControl(const std::array<double, 7UL>& q, const std::array<double, 7UL>& qd,
                        const std::array<double, 7UL>& qdd);

    bool directJControl(const std::array<double, 7UL>& q, const std::array<double, 7UL>& qd,
                        const std::array<double, 7UL>& qdd, const std::array<double, 7UL>& torque);

    enum EClearRequest { CLEAR_HALT = 0, UNSUSPEND = 1, CONTINUE_INIT = 2, RESUME = 3, CBUN_EVENT = 4 };

    int64_t clearAlarmRequest(EClearRequest alarm_request);

private:
    std::shared_ptr<KordCore> kord_;
};

}  // namespace kr2::kord
