#include "events.hpp"

#include <cstdio>

#include "arm_session.hpp"

namespace station_kord {

namespace {

struct Text {
    uint32_t id;
    const char* text;
};

constexpr Text kTexts[] = {
    {1001, "emergency stop; release it and confirm at the controller"},
    {1004, "joint sensors and the controller's model are too far apart"},
    {1005, "two references in a row are too far apart; a command jumped"},
    {1006, "a joint is faster than it is rated for"},
    {1007, "a joint's torque is beyond what it is rated for"},
    {1010, "torque deviation: commands came late or jumped, see the order of calls"},
    {1011, "trajectory and model are too far apart"},
    {2002, "a joint is faster than its limit"},
    {2003, "a joint's torque is beyond its limit"},
    {2005, "a target is outside a joint's range"},
    {3001, "bad connection quality: too many commands waited, or none came in motion"},
    {3002, "infeasible move: the target is too far for its time"},
    {3003, "communication error"},
};

constexpr Text kNotReadyTexts[] = {
    {kOffline, "offline"},
    {kInit, "initialising"},
    {kReinit, "initialising anew"},
    {kBackdrive, "moved by hand"},
    {kPaused, "paused"},
    {kMaintenance, "under maintenance"},
};

}  // namespace

std::string number(double value) {
    char text[32];
    std::snprintf(text, sizeof text, "%.4g", value);
    return text;
}

const char* group_name(uint32_t group) {
    constexpr const char* kNames[] = {"unknown", "safety", "soft-stop", "kord", "hardware", "connection"};
    return kNames[group < 6 ? group : 0];
}

const char* event_text(uint32_t id) {
    for (const Text& known : kTexts)
        if (known.id == id) return known.text;
    return id == 0 ? "no heartbeat from the controller; the session is lost" : "see the controller's own display";
}

std::string not_ready_text(uint32_t motion_flags) {
    std::string text;
    for (const Text& known : kNotReadyTexts)
        if (motion_flags & known.id) text += (text.empty() ? "" : ", ") + std::string(known.text);
    return text;
}

}  // namespace station_kord
