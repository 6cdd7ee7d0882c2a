// What station and guard say to each other over UDP. All numbers are little endian; the last four bytes of each
// datagram are the CRC-32 of zlib over all bytes before them. adapters/robots/g1/dds/guard_client.py is the other side.
//
// Station to guard, a request: `struct request_head`, then, in a COMMAND only, `struct targets`, then the checksum.
// Arming: the station sends ARM with a number of its own as token; the guard answers CHALLENGE with that number and one
// of its own, or ARM_REFUSED with the reason; the station sends CONFIRM with the guard's number as token within a
// second; the guard answers ARMED. From then on each COMMAND and DISARM carries the guard's number as token, so that
// nothing of an earlier session moves the robot.
//
// Guard to station, an answer: `struct answer`. STATUS comes 50 times a second to whoever was heard within a second.
#ifndef G1_GUARD_DATAGRAM_H
#define G1_GUARD_DATAGRAM_H

#include <stddef.h>
#include <stdint.h>

#define MOTORS 29
#define DATAGRAM_VERSION 1
#define REQUEST_MAGIC "G1GD"
#define ANSWER_MAGIC "G1GS"
#define HOST_LETTERS 64
#define PROCESS_LETTERS 32

enum request_kind { KIND_HELLO = 1, KIND_ARM, KIND_CONFIRM, KIND_COMMAND, KIND_DISARM, KINDS };
enum answer_kind { ANSWER_STATUS = 1, ANSWER_CHALLENGE, ANSWER_ARMED, ANSWER_ARM_REFUSED, ANSWERS };

enum guard_state {
    STATE_WAITING = 0,  // not armed since the start: sends nothing
    STATE_ARMED,        // follows commands
    STATE_FROZEN,       // no command for 60 ms: repeats what it sent last; a command within 100 ms goes on
    STATE_RAMPING,      // damping, while the stiffness falls to zero
    STATE_DAMPING,      // no stiffness, for ever, until armed anew
    STATES,
};

// Why the guard came to damping, or why it does not arm.
enum reason {
    REASON_NONE = 0,
    REASON_SILENCE,         // no command for 100 ms
    REASON_DISARMED,        // the station asked for it
    REASON_NO_STATE,        // no LowState for 50 ms
    REASON_TICK,            // the tick of LowState did not count for 50 ms
    REASON_TILT,            // more than 60 degrees
    REASON_WINDING,         // 120 °C or more
    REASON_CASING,          // 85 °C or more
    REASON_MOTOR_ERROR,     // error bits of a motor of a leg
    REASON_FOREIGN_WRITER,  // somebody else writes rt/lowcmd
    REASON_REMOTE,          // SELECT, or L2 and B, held on the remote
    REASON_REFUSALS,        // three damaged or impossible datagrams in a row
    REASON_LATE,            // the guard itself stood still for 100 ms
    REASON_ENDING,          // the guard was told to end
    REASON_RESTARTED,       // the guard before this one ended while armed
    REASON_MACHINE,         // mode_machine is not that of a G1
    REASON_BUSY,            // it is armed, or the stiffness falls
    REASON_CHALLENGE,       // wrong number, or later than a second
    REASON_STARTING,        // it runs for less than a second: who else writes is not known yet
    REASONS,
};

// Why a datagram was refused; the index of its counter.
enum refusal {
    REFUSED_SIZE = 0,
    REFUSED_MAGIC,
    REFUSED_VERSION,
    REFUSED_CRC,
    REFUSED_KIND,
    REFUSED_NUMBER,     // not finite
    REFUSED_LIMIT,      // a gain out of its range, or a position far outside of the joint's
    REFUSED_SEQ,        // not newer than the last
    REFUSED_SENDER,     // not who armed
    REFUSED_TOKEN,      // of another session
    REFUSED_STALE,      // answers a LowState of more than 100 ms ago, or one that has not come
    REFUSED_NOT_ARMED,
    REFUSALS,
    NOT_REFUSED = REFUSALS,
};

struct targets {
    float q[MOTORS];   // [rad]
    float kp[MOTORS];  // [N m/rad]
    float kd[MOTORS];  // [N m s/rad]
};

struct request_head {
    char magic[4];
    uint8_t version;
    uint8_t kind;
    uint16_t size;        // of the whole datagram
    uint32_t seq;         // grows with each datagram of a session
    uint32_t state_tick;  // of the LowState that a COMMAND answers [ms]
    uint64_t sender_ns;   // monotonic clock of the sender; comes back in answers
    uint64_t token;       // ARM: a number of the station's; else the guard's
};

struct answer {
    char magic[4];
    uint8_t version;
    uint8_t kind;
    uint16_t size;
    uint32_t seq;
    uint8_t state;
    uint8_t reason;        // of damping; in ARM_REFUSED why not
    uint8_t why_not;       // what now is in the way of arming; 0: nothing
    uint8_t mode_machine;  // of the newest LowState
    uint64_t guard_ns;     // monotonic clock of the guard
    uint64_t sender_ns;    // of the newest intact datagram
    uint64_t nonce;        // CHALLENGE, ARMED, ARM_REFUSED: the station's number
    uint64_t challenge;    // CHALLENGE, ARMED: the guard's number
    uint32_t command_seq;  // of the newest accepted command
    uint32_t state_tick;   // of the newest LowState [ms]
    uint32_t state_age_us;  // 0xFFFFFFFF: never
    uint32_t command_age_us;
    uint32_t sent;         // LowCmds
    uint32_t accepted;     // commands
    uint32_t refused[REFUSALS];
    uint32_t states, bad_states;  // LowStates that were good, and those with a wrong checksum or no numbers
    uint32_t freezes, damped;     // how often
    uint32_t clamped;             // commands of which a position was outside of a joint's range
    uint32_t max_late_us;         // of the guard's own 2 ms
    uint8_t is_realtime;          // SCHED_FIFO was granted
    uint8_t is_foreign;           // somebody else writes rt/lowcmd
    uint8_t reserved[2];
    int32_t foreign_pid;          // 0: unknown, or nobody
    char foreign_host[HOST_LETTERS];
    char foreign_process[PROCESS_LETTERS];
    uint32_t failed_sends;  // LowCmds that DDS did not take
    uint32_t crc;
};

#define CRC_SIZE sizeof(uint32_t)
#define SHORT_SIZE (sizeof(struct request_head) + CRC_SIZE)
#define COMMAND_SIZE (sizeof(struct request_head) + sizeof(struct targets) + CRC_SIZE)

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "datagrams are structs as they are in memory");
_Static_assert(sizeof(struct request_head) == 32 && sizeof(struct targets) == 348, "no padding");
_Static_assert(SHORT_SIZE == 36 && COMMAND_SIZE == 384, "as in guard_client.py");
_Static_assert(sizeof(struct answer) == 256, "no padding, as in guard_client.py");

struct request {
    struct request_head head;
    struct targets targets;  // of a COMMAND
};

// Takes a datagram apart; returns why it is refused, or NOT_REFUSED. Whether it may move anything is not asked here.
enum refusal datagram_read(const uint8_t *data, size_t size, struct request *out);

// Fills in what every answer has: magic, version, size and checksum.
void datagram_seal(struct answer *answer);

#endif
