// The guard's rules: what is sent to the motors, and when it comes to damping. No clock, no socket, no DDS: the time is
// given [ns, monotonic], so that each rule can be tested to the millisecond.
#ifndef G1_GUARD_GUARD_H
#define G1_GUARD_GUARD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "datagram.h"

#define MS 1000000LL
#define PERIOD_NS (2 * MS)
#define REMOTE_BYTES 40

// A LowState, as far as rules need it. The checksum is right when it comes here.
struct robot_state {
    uint8_t mode_machine;
    uint8_t remote[REMOTE_BYTES];
    uint32_t tick;                   // [ms]
    float quat_wxyz[4];
    float q[MOTORS];                 // [rad]
    int16_t temperature[MOTORS][2];  // of casing and winding [°C]
    uint32_t error[MOTORS];
};

// A LowCmd, as far as it is not the same each time.
struct motor_command {
    uint8_t mode_machine;
    uint8_t mode[MOTORS];  // 1: enabled
    struct targets targets;
};

struct foreign_writer {
    bool is_there;
    int32_t pid;  // 0: it does not say
    char host[HOST_LETTERS];
    char process[PROCESS_LETTERS];
};

struct guard {
    uint64_t (*random)(void);
    enum guard_state state;
    enum reason reason;
    int64_t begin_ns, step_ns, ramp_ns, end_ns;  // start; last step; begin of the ramp; told to end (0: not)

    struct robot_state robot;  // the newest
    bool has_robot;
    int64_t robot_ns, tick_ns;  // when a LowState last came, and when its tick last counted
    int stop_frames;            // messages in a row by which a stop is held on the remote
    struct foreign_writer foreign;

    uint64_t peer, listener;  // addresses: who armed; who was heard last
    int64_t heard_ns;
    uint64_t sender_ns;
    uint64_t nonce, challenge, challenger;  // of a handshake that is open; a challenge is good once
    int64_t challenge_ns;
    uint64_t session;  // token of who armed
    uint32_t seq;
    bool has_seq;
    int64_t armed_ns, command_ns;  // when it was armed; when a command last came
    struct targets wanted;
    int refusals_in_row;

    struct targets sent;
    float ramp_kp[MOTORS];
    bool is_realtime;
    uint32_t answers, sent_count, accepted, states, bad_states, freezes, damped, clamped, max_late_us, failed_sends;
    uint32_t refused[REFUSALS];
};

// `was_armed`: the guard before this one ended while armed, so that this one begins with damping.
void guard_init(struct guard *guard, int64_t now_ns, bool was_armed, uint64_t (*random)(void));

// A datagram came from an address, which is any number but 0. Returns true when `reply` goes back to it at once.
bool guard_on_datagram(struct guard *guard, int64_t now_ns, const uint8_t *data, size_t size, uint64_t from,
                       struct answer *reply);

void guard_on_state(struct guard *guard, int64_t now_ns, const struct robot_state *state);
void guard_on_bad_state(struct guard *guard);
void guard_on_foreign(struct guard *guard, const struct foreign_writer *foreign);

// Decides. Returns true when `out` is to be sent.
bool guard_step(struct guard *guard, int64_t now_ns, struct motor_command *out);

// From now on the motors come to damping, whatever comes, and then the guard is done.
void guard_end(struct guard *guard, int64_t now_ns);
bool guard_is_done(const struct guard *guard, int64_t now_ns);

// The address that a status goes to now; 0: nobody was heard for a second.
uint64_t guard_listener(const struct guard *guard, int64_t now_ns);
void guard_status(struct guard *guard, int64_t now_ns, struct answer *out);

#endif
