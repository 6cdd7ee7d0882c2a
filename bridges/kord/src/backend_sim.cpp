#include "backend.hpp"
#include "session.hpp"

namespace station_kord {

const char* backend() { return "sim"; }

bool look_inside(kr2::kord::KordCore& core, Insight& insight) {
    const kordsim::Status& status = core.session().fetched();
    if (status.is_opaque) return false;
    insight = {status.queued_motion_s, status.planner_backlog, status.late_commands};
    return true;
}

}  // namespace station_kord
