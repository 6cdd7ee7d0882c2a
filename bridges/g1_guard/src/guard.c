#include "guard.h"

#include <math.h>
#include <string.h>

#include "limits.h"

#define FREEZE_NS (60 * MS)
#define SILENCE_NS (100 * MS)
#define RAMP_NS (300 * MS)
#define END_NS (300 * MS)
#define STATE_AGE_NS (50 * MS)
#define STANDSTILL_NS (100 * MS)
#define CHALLENGE_NS (1000 * MS)
#define LISTENER_NS (1000 * MS)
#define DISCOVERY_NS (1000 * MS)  // writers that are there are found in a tenth of it

#define STALE_MS 100
#define AHEAD_MS 50     // LowState can reach the station before the guard
#define TICK_BACK_MS 1000  // less is a message that was overtaken; more is a robot that began anew
#define DAMPING_KD 8.0f    // as in Unitree's helpers and all peers [N m s/rad]
#define UPRIGHT 0.5f       // cosine of the tilt of 60 degrees
#define WINDING_C 120
#define CASING_C 85
#define LEG_MOTORS 12
#define TIMED_OUT 0x40000000u     // error bit of a motor that gets no commands: so it is while nothing is sent
#define COMMANDED_NS (1000 * MS)  // after so long of commands such a motor is ill
#define MOST_REFUSALS 3
#define STOP_FRAMES 2
#define FAR_OUTSIDE_RAD 3.0f  // policies command past a limit on purpose; this far is degrees, or garbage

#define MOTOR(i) (1u << (i))
#define WAIST (MOTOR(13) | MOTOR(14))                               // roll and pitch
#define WRISTS (MOTOR(20) | MOTOR(21) | MOTOR(27) | MOTOR(28))      // pitch and yaw

static bool is_live(const struct guard *guard) {
    return guard->state == STATE_ARMED || guard->state == STATE_FROZEN;
}

void guard_init(struct guard *guard, int64_t now_ns, bool was_armed, uint64_t (*random)(void)) {
    memset(guard, 0, sizeof *guard);
    guard->random = random;
    guard->begin_ns = guard->step_ns = now_ns;
    if (was_armed) {
        guard->state = STATE_DAMPING;
        guard->reason = REASON_RESTARTED;
        guard->damped = 1;
    }
}

static void begin_damping(struct guard *guard, int64_t now_ns, enum reason reason) {
    if (!is_live(guard)) return;
    guard->state = STATE_RAMPING;
    guard->reason = reason;
    guard->ramp_ns = now_ns;
    ++guard->damped;
    memcpy(guard->ramp_kp, guard->sent.kp, sizeof guard->ramp_kp);
}

// ---- the robot ----

static bool is_stop_held(const uint8_t remote[REMOTE_BYTES], bool *is_valid) {
    const bool has_head = remote[0] == 0x55 && remote[1] == 0x51;
    *is_valid = has_head || (remote[0] == 0 && remote[1] == 0);  // simulators send none; any other is damage
    const bool select = remote[2] & 0x08, l2 = remote[2] & 0x20, b = remote[3] & 0x02;
    return select || (l2 && b);
}

static void on_remote(struct guard *guard, const uint8_t remote[REMOTE_BYTES]) {
    bool is_valid;
    const bool is_held = is_stop_held(remote, &is_valid);
    if (!is_valid) return;
    if (!is_held) guard->stop_frames = 0;
    else if (guard->stop_frames < STOP_FRAMES) ++guard->stop_frames;
}

static float square(const float quat[4]) {
    return quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3];
}

// A robot with a locked waist lacks two of the motors, one with 23 joints six.
static uint32_t absent_motors(uint8_t mode_machine) {
    if (mode_machine == 3 || mode_machine == 6) return WAIST;
    return mode_machine == 1 || mode_machine == 4 ? WAIST | WRISTS : 0;
}

static bool is_number(const struct robot_state *state) {
    const uint32_t absent = absent_motors(state->mode_machine);
    const float length = square(state->quat_wxyz);
    if (!(length > 0.5f && length < 2.0f)) return false;  // zeros come from SDKs that have heard nothing yet
    for (int i = 0; i < MOTORS; ++i)
        if (!(absent & MOTOR(i)) && !isfinite(state->q[i])) return false;
    return true;
}

void guard_on_bad_state(struct guard *guard) { ++guard->bad_states; }

void guard_on_state(struct guard *guard, int64_t now_ns, const struct robot_state *state) {
    if (!is_number(state)) {
        guard_on_bad_state(guard);
        return;
    }
    const int32_t ahead = (int32_t)(state->tick - guard->robot.tick);
    const bool is_overtaken = guard->has_robot && ahead < 0 && ahead > -TICK_BACK_MS;
    ++guard->states;
    guard->robot_ns = now_ns;
    on_remote(guard, state->remote);
    if (is_overtaken) return;
    if (!guard->has_robot || ahead > 0) guard->tick_ns = now_ns;
    guard->robot = *state;
    guard->has_robot = true;
}

void guard_on_foreign(struct guard *guard, const struct foreign_writer *foreign) { guard->foreign = *foreign; }

static enum reason heat_or_error(const struct guard *guard, int64_t now_ns) {
    const struct robot_state *robot = &guard->robot;
    const uint32_t absent = absent_motors(robot->mode_machine);
    const uint32_t ignored = is_live(guard) && now_ns - guard->armed_ns > COMMANDED_NS ? 0 : TIMED_OUT;
    for (int i = 0; i < MOTORS; ++i) {
        if (absent & MOTOR(i)) continue;
        if (robot->temperature[i][1] >= WINDING_C) return REASON_WINDING;
        if (robot->temperature[i][0] >= CASING_C) return REASON_CASING;
        if (i < LEG_MOTORS && (robot->error[i] & ~ignored) != 0) return REASON_MOTOR_ERROR;
    }
    return REASON_NONE;
}

static bool is_tilted(const float quat[4]) {
    const float up = quat[0] * quat[0] - quat[1] * quat[1] - quat[2] * quat[2] + quat[3] * quat[3];
    return up < UPRIGHT * square(quat);
}

// What speaks against stiff motors now, whatever the station says.
static enum reason fault(const struct guard *guard, int64_t now_ns) {
    if (guard->stop_frames >= STOP_FRAMES) return REASON_REMOTE;
    if (!guard->has_robot || now_ns - guard->robot_ns > STATE_AGE_NS) return REASON_NO_STATE;
    if (now_ns - guard->tick_ns > STATE_AGE_NS) return REASON_TICK;
    if (guard->foreign.is_there) return REASON_FOREIGN_WRITER;
    if (is_tilted(guard->robot.quat_wxyz)) return REASON_TILT;
    return heat_or_error(guard, now_ns);
}

// ---- arming ----

static bool is_g1(uint8_t mode_machine) { return mode_machine >= 1 && mode_machine <= 6; }

static enum reason why_not_arm(const struct guard *guard, int64_t now_ns) {
    if (guard->end_ns != 0) return REASON_ENDING;
    if (is_live(guard) || guard->state == STATE_RAMPING) return REASON_BUSY;
    if (now_ns - guard->begin_ns < DISCOVERY_NS) return REASON_STARTING;
    const enum reason found = fault(guard, now_ns);
    if (found != REASON_NONE) return found;
    return is_g1(guard->robot.mode_machine) ? REASON_NONE : REASON_MACHINE;
}

// The first target is the measured pose without stiffness: nothing moves until a command says so.
static void become_armed(struct guard *guard, int64_t now_ns, uint64_t from) {
    guard->state = STATE_ARMED;
    guard->reason = REASON_NONE;
    guard->peer = from;
    guard->session = guard->challenge;
    guard->challenge = 0;
    guard->armed_ns = guard->command_ns = now_ns;
    guard->has_seq = false;
    guard->refusals_in_row = 0;
    memset(&guard->sent, 0, sizeof guard->sent);
    memcpy(guard->sent.q, guard->robot.q, sizeof guard->sent.q);
    for (int i = 0; i < MOTORS; ++i) guard->sent.kd[i] = DAMPING_KD;
    guard->wanted = guard->sent;
}

static bool answer_arming(struct guard *guard, int64_t now_ns, enum answer_kind kind, uint64_t nonce,
                          struct answer *reply) {
    guard_status(guard, now_ns, reply);
    reply->kind = (uint8_t)kind;
    reply->nonce = nonce;
    reply->challenge = kind == ANSWER_ARMED ? guard->session : guard->challenge;
    datagram_seal(reply);
    return true;
}

static bool refuse_arming(struct guard *guard, int64_t now_ns, uint64_t nonce, enum reason why_not,
                          struct answer *reply) {
    guard_status(guard, now_ns, reply);
    reply->kind = ANSWER_ARM_REFUSED;
    reply->nonce = nonce;
    reply->reason = (uint8_t)why_not;
    datagram_seal(reply);
    return true;
}

static bool on_arm(struct guard *guard, int64_t now_ns, uint64_t nonce, uint64_t from, struct answer *reply) {
    const enum reason why_not = why_not_arm(guard, now_ns);
    if (why_not != REASON_NONE) return refuse_arming(guard, now_ns, nonce, why_not, reply);
    const bool is_repeated = guard->challenger == from && guard->nonce == nonce && guard->challenge != 0 &&
                             now_ns - guard->challenge_ns < CHALLENGE_NS;
    if (!is_repeated) {
        guard->challenge = guard->random();
        guard->nonce = nonce;
        guard->challenger = from;
        guard->challenge_ns = now_ns;
    }
    return answer_arming(guard, now_ns, ANSWER_CHALLENGE, nonce, reply);
}

static bool on_confirm(struct guard *guard, int64_t now_ns, uint64_t token, uint64_t from, struct answer *reply) {
    if (is_live(guard) && token == guard->session && from == guard->peer)  // the answer to the first was lost
        return answer_arming(guard, now_ns, ANSWER_ARMED, guard->nonce, reply);
    const bool is_right = token != 0 && token == guard->challenge && from == guard->challenger &&
                          now_ns - guard->challenge_ns <= CHALLENGE_NS;
    enum reason why_not = why_not_arm(guard, now_ns);
    if (why_not == REASON_NONE && !is_right) why_not = REASON_CHALLENGE;
    if (why_not != REASON_NONE) return refuse_arming(guard, now_ns, guard->nonce, why_not, reply);
    become_armed(guard, now_ns, from);
    return answer_arming(guard, now_ns, ANSWER_ARMED, guard->nonce, reply);
}

// ---- commands ----

static float clamp(float value, float low, float high) { return value < low ? low : value > high ? high : value; }

static enum refusal check_numbers(const struct targets *targets) {
    for (int i = 0; i < MOTORS; ++i)
        if (!isfinite(targets->q[i]) || !isfinite(targets->kp[i]) || !isfinite(targets->kd[i])) return REFUSED_NUMBER;
    for (int i = 0; i < MOTORS; ++i) {
        const struct joint_limits *limit = &JOINT_LIMITS[i];
        const float q = targets->q[i], kp = targets->kp[i], kd = targets->kd[i];
        if (kp < 0 || kp > limit->kp_max || kd < 0 || kd > limit->kd_max) return REFUSED_LIMIT;
        if (q < limit->lower_rad - FAR_OUTSIDE_RAD || q > limit->upper_rad + FAR_OUTSIDE_RAD) return REFUSED_LIMIT;
    }
    return NOT_REFUSED;
}

static enum refusal check_command(const struct guard *guard, const struct request *request) {
    const int32_t age_ms = (int32_t)(guard->robot.tick - request->head.state_tick);
    if (!is_live(guard)) return REFUSED_NOT_ARMED;
    if (request->head.token != guard->session) return REFUSED_TOKEN;
    if (guard->has_seq && (int32_t)(request->head.seq - guard->seq) <= 0) return REFUSED_SEQ;
    if (age_ms > STALE_MS || age_ms < -AHEAD_MS) return REFUSED_STALE;
    return check_numbers(&request->targets);
}

static void accept(struct guard *guard, int64_t now_ns, const struct request *request) {
    bool is_clamped = false;
    guard->wanted = request->targets;
    for (int i = 0; i < MOTORS; ++i) {
        guard->wanted.q[i] = clamp(request->targets.q[i], JOINT_LIMITS[i].lower_rad, JOINT_LIMITS[i].upper_rad);
        is_clamped |= guard->wanted.q[i] != request->targets.q[i];
    }
    guard->state = STATE_ARMED;
    guard->seq = request->head.seq;
    guard->has_seq = true;
    guard->command_ns = now_ns;
    guard->refusals_in_row = 0;
    guard->clamped += is_clamped;
    ++guard->accepted;
}

// Damage and impossible numbers of who armed end the session; what is only old, or of somebody else, does not.
static void refuse(struct guard *guard, int64_t now_ns, enum refusal why, uint64_t from) {
    ++guard->refused[why];
    if (why > REFUSED_LIMIT || !is_live(guard) || from != guard->peer) return;
    if (++guard->refusals_in_row >= MOST_REFUSALS) begin_damping(guard, now_ns, REASON_REFUSALS);
}

static enum refusal on_disarm(struct guard *guard, int64_t now_ns, uint64_t token) {
    if (!is_live(guard)) return REFUSED_NOT_ARMED;
    if (token != guard->session) return REFUSED_TOKEN;
    begin_damping(guard, now_ns, REASON_DISARMED);
    return NOT_REFUSED;
}

bool guard_on_datagram(struct guard *guard, int64_t now_ns, const uint8_t *data, size_t size, uint64_t from,
                       struct answer *reply) {
    struct request request;
    enum refusal why = datagram_read(data, size, &request);
    const bool is_stranger = is_live(guard) && from != guard->peer;
    if (why == NOT_REFUSED && !is_stranger) {
        guard->listener = from;
        guard->heard_ns = now_ns;
        guard->sender_ns = request.head.sender_ns;
    }
    if (why == NOT_REFUSED && request.head.kind == KIND_ARM)
        return on_arm(guard, now_ns, request.head.token, from, reply);
    if (why == NOT_REFUSED && request.head.kind == KIND_CONFIRM)
        return on_confirm(guard, now_ns, request.head.token, from, reply);
    if (why == NOT_REFUSED && is_stranger) why = REFUSED_SENDER;
    if (why == NOT_REFUSED && request.head.kind == KIND_DISARM) why = on_disarm(guard, now_ns, request.head.token);
    if (why == NOT_REFUSED && request.head.kind == KIND_COMMAND) {
        why = check_command(guard, &request);
        if (why == NOT_REFUSED) accept(guard, now_ns, &request);
    }
    if (why != NOT_REFUSED) refuse(guard, now_ns, why, from);
    return false;
}

// ---- what is sent ----

static void follow(struct guard *guard, int64_t since_ns) {
    const float seconds = (float)(since_ns < PERIOD_NS ? since_ns : PERIOD_NS) * 1e-9f;
    for (int i = 0; i < MOTORS; ++i) {
        const float most = JOINT_LIMITS[i].speed_rad_s * seconds;
        guard->sent.q[i] += clamp(guard->wanted.q[i] - guard->sent.q[i], -most, most);
        guard->sent.kp[i] = guard->wanted.kp[i];
        guard->sent.kd[i] = guard->wanted.kd[i];
    }
}

static void ramp(struct guard *guard, int64_t now_ns) {
    const float left = clamp(1.0f - (float)(now_ns - guard->ramp_ns) / (float)RAMP_NS, 0.0f, 1.0f);
    for (int i = 0; i < MOTORS; ++i) {
        guard->sent.kp[i] = guard->ramp_kp[i] * left;
        guard->sent.kd[i] = DAMPING_KD;
    }
}

static void fill(const struct guard *guard, struct motor_command *out) {
    out->mode_machine = guard->robot.mode_machine;
    out->targets = guard->sent;
    memset(out->mode, 1, sizeof out->mode);
    const uint32_t absent = absent_motors(out->mode_machine);
    for (int i = 0; i < MOTORS; ++i) {
        if (!(absent & MOTOR(i))) continue;
        out->mode[i] = 0;
        out->targets.q[i] = out->targets.kp[i] = out->targets.kd[i] = 0;
    }
}

static void decide(struct guard *guard, int64_t now_ns) {
    const bool stood_still = now_ns - guard->step_ns > STANDSTILL_NS;
    const int64_t silence_ns = now_ns - guard->command_ns;
    if (is_live(guard)) {
        const enum reason found = fault(guard, now_ns);
        if (stood_still) begin_damping(guard, now_ns, REASON_LATE);
        else if (found != REASON_NONE) begin_damping(guard, now_ns, found);
        else if (silence_ns >= SILENCE_NS) begin_damping(guard, now_ns, REASON_SILENCE);
    }
    if (guard->state == STATE_ARMED && silence_ns >= FREEZE_NS) {
        guard->state = STATE_FROZEN;
        ++guard->freezes;
    }
    if (guard->state == STATE_RAMPING && now_ns - guard->ramp_ns >= RAMP_NS) guard->state = STATE_DAMPING;
}

bool guard_step(struct guard *guard, int64_t now_ns, struct motor_command *out) {
    const int64_t late_us = (now_ns - guard->step_ns - PERIOD_NS) / 1000;
    if (late_us > guard->max_late_us) guard->max_late_us = (uint32_t)late_us;
    decide(guard, now_ns);
    const int64_t since_ns = now_ns - guard->step_ns;
    guard->step_ns = now_ns;
    if (guard->state == STATE_WAITING || !guard->has_robot) return false;  // whose mode_machine is not known
    if (guard->state == STATE_ARMED) follow(guard, since_ns);
    if (guard->state == STATE_RAMPING || guard->state == STATE_DAMPING) ramp(guard, now_ns);
    fill(guard, out);
    ++guard->sent_count;
    return true;
}

void guard_end(struct guard *guard, int64_t now_ns) {
    if (guard->end_ns != 0) return;
    guard->end_ns = now_ns;
    begin_damping(guard, now_ns, REASON_ENDING);
    if (guard->state == STATE_RAMPING) guard->end_ns = guard->ramp_ns + RAMP_NS;
}

bool guard_is_done(const struct guard *guard, int64_t now_ns) {
    if (guard->end_ns == 0) return false;
    return guard->state == STATE_WAITING || now_ns - guard->end_ns >= END_NS;
}

// ---- what the station hears ----

uint64_t guard_listener(const struct guard *guard, int64_t now_ns) {
    return guard->listener != 0 && now_ns - guard->heard_ns < LISTENER_NS ? guard->listener : 0;
}

static uint32_t age_us(bool is_known, int64_t now_ns, int64_t then_ns) {
    const int64_t age = (now_ns - then_ns) / 1000;
    return !is_known ? UINT32_MAX : age < 0 ? 0 : age >= UINT32_MAX ? UINT32_MAX - 1 : (uint32_t)age;
}

void guard_status(struct guard *guard, int64_t now_ns, struct answer *out) {
    memset(out, 0, sizeof *out);
    out->kind = ANSWER_STATUS;
    out->seq = ++guard->answers;
    out->state = (uint8_t)guard->state;
    out->reason = (uint8_t)guard->reason;
    out->why_not = (uint8_t)why_not_arm(guard, now_ns);
    out->mode_machine = guard->robot.mode_machine;
    out->guard_ns = (uint64_t)now_ns;
    out->sender_ns = guard->sender_ns;
    out->command_seq = guard->seq;
    out->state_tick = guard->robot.tick;
    out->state_age_us = age_us(guard->has_robot, now_ns, guard->robot_ns);
    out->command_age_us = age_us(guard->has_seq, now_ns, guard->command_ns);
    out->sent = guard->sent_count;
    out->accepted = guard->accepted;
    memcpy(out->refused, guard->refused, sizeof out->refused);
    out->states = guard->states;
    out->bad_states = guard->bad_states;
    out->freezes = guard->freezes;
    out->damped = guard->damped;
    out->clamped = guard->clamped;
    out->max_late_us = guard->max_late_us;
    out->is_realtime = guard->is_realtime;
    out->failed_sends = guard->failed_sends;
    out->is_foreign = guard->foreign.is_there;
    if (guard->foreign.is_there) {
        out->foreign_pid = guard->foreign.pid;
        memcpy(out->foreign_host, guard->foreign.host, HOST_LETTERS - 1);
        memcpy(out->foreign_process, guard->foreign.process, PROCESS_LETTERS - 1);
    }
    datagram_seal(out);
}
