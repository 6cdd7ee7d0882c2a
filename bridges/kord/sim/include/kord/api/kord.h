// Stand-in for the part of kord-api that the bridge uses: the same names, values and signatures, another inside.
// What they mean is told in docs/kassow.md; nothing here is kord-api's own text.
#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include <kord/system/SystemEvent.h>

namespace kordsim {
class Session;
}

namespace kr2::kord {

enum connection { UDP_SERVER, UDP_CLIENT };

enum TrackingType {
    TT_NONE,
    TT_TIME,
    TT_WS_TARGET_SPEED,
    TT_JS_TARGET_SPEED,
    TT_SP_APX_SPEED,
    TT_SP_CNST_SPEED,
    TT_SP_DURATION
};

enum BlendType { BT_NONE, BT_TIME, BT_WS_ACCELERATION, BT_WS_RADIUS, BT_JS_ACCELERATION };

enum OverlayType { OT_NONE, OT_VIAPOINT, OT_STOPPOINT };

enum EFrameID { ROBOT_BASE_FRAME = 0, TFC_FRAME = 7, TCP_FRAME = 8, LAST_TARGET_POSE_FRAME = 9 };

enum EFrameValue { POSE_VAL_REF_WF = 0, POSE_VAL_REF_TFC = 1 };

enum ELoadID { LOAD1 = 0, LOAD2 = 1 };

enum { F_NONE = 0 };
enum { F_SYNC_FULL_ROTATION = 1 };

using token_t = int64_t;

class KordCore {
public:
    explicit KordCore(const std::string& hostname, unsigned int port, unsigned int session_id, connection conn);
    ~KordCore();
    KordCore(const KordCore&) = delete;
    KordCore& operator=(const KordCore&) = delete;

    bool connect(const char* device = nullptr);
    bool disconnect();
    bool syncRC(long flags = F_SYNC_FULL_ROTATION);
    bool waitSync(std::chrono::microseconds timeout = std::chrono::microseconds(8000), long flags = F_NONE);
    void spin();

    // The stand-in's own; nothing that links kord-api may call it.
    kordsim::Session& session() { return *session_; }

private:
    std::unique_ptr<kordsim::Session> session_;
};

}  // namespace kr2::kord
