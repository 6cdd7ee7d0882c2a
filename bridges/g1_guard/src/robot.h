// The robot's network: its LowState, our LowCmd, and who else writes rt/lowcmd.
#ifndef G1_GUARD_ROBOT_H
#define G1_GUARD_ROBOT_H

#include <stdatomic.h>
#include <stdbool.h>

#include "guard.h"

#define MOST_STATES 8

// Joins a domain on one interface. Returns false with a line on stderr when it cannot.
bool robot_open(const char *interface, unsigned domain);
void robot_close(void);

// Fills in what came since the last call, oldest first, and counts those that are damaged. Does not wait.
int robot_take(struct robot_state states[MOST_STATES], int *damaged);

// Returns false when DDS did not take it. Does not wait.
bool robot_send(const struct motor_command *command);

// Looks for another writer of rt/lowcmd, or waits up to 100 ms for news; for a thread without real-time priority.
// Returns whether `out` was filled in.
bool robot_discover(struct foreign_writer *out);

#endif
