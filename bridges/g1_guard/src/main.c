// g1-guard: the only writer of rt/lowcmd on a G1. A station commands it over UDP; when the station dies, freezes or is
// cut off, the robot comes to damping. `guard.c` has the rules; here are clock, socket, signals and options.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <netinet/in.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "crc.h"
#include "guard.h"
#include "robot.h"

#define NAME "g1-guard: "
#define PRIORITY 60
#define MOST_DATAGRAMS 256  // of one period
#define STEPS_PER_STATUS 10
#define USAGE_CODE 2

struct options {
    const char *interface, *bind, *armed_flag;
    unsigned domain, port;
};

static volatile sig_atomic_t is_told_to_end;
static atomic_int is_over, told_state, told_reason;
static pthread_mutex_t foreign_lock = PTHREAD_MUTEX_INITIALIZER;
static struct foreign_writer foreign;
static bool foreign_is_new;

static const char HELP[] =
    "g1-guard: the only writer of rt/lowcmd on a G1; damping when its station is silent\n"
    "  --interface NAME   network interface of the robot (default: lo)\n"
    "  --domain N         DDS domain, 0 to 230 (default: 0, a robot's)\n"
    "  --bind ADDRESS     IPv4 address to listen on for the station (default: 127.0.0.1)\n"
    "  --port N           UDP port (default: 47029)\n"
    "  --armed-flag FILE  remembers that it is armed: a guard that is started after a crash begins with damping\n"
    "  --help             this\n";

static const char *const STATE_WORDS[STATES] = {"waiting", "armed", "frozen", "ramping", "damping"};
static const char *const REASON_WORDS[REASONS] = {
    [REASON_NONE] = "",
    [REASON_SILENCE] = ": no command for 100 ms",
    [REASON_DISARMED] = ": the station disarmed it",
    [REASON_NO_STATE] = ": no LowState for 50 ms",
    [REASON_TICK] = ": the tick of LowState did not count for 50 ms",
    [REASON_TILT] = ": tilted by more than 60 degrees",
    [REASON_WINDING] = ": a winding has 120 degrees or more",
    [REASON_CASING] = ": a casing has 85 degrees or more",
    [REASON_MOTOR_ERROR] = ": a motor of a leg reports an error",
    [REASON_FOREIGN_WRITER] = ": somebody else writes rt/lowcmd",
    [REASON_REMOTE] = ": SELECT or L2+B on the remote",
    [REASON_REFUSALS] = ": three bad datagrams in a row",
    [REASON_LATE] = ": the guard itself stood still for 100 ms",
    [REASON_ENDING] = ": told to end",
    [REASON_RESTARTED] = ": the guard before this one ended while armed",
    [REASON_MACHINE] = "",
    [REASON_BUSY] = "",
    [REASON_CHALLENGE] = "",
    [REASON_STARTING] = "",
};

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000LL + now.tv_nsec;
}

static uint64_t draw(void) {
    uint64_t number = 0;  // no session has the number 0, so none is armed when the system has no random numbers yet
    if (getrandom(&number, sizeof number, GRND_NONBLOCK) != (ssize_t)sizeof number) return 0;
    return number;
}

// ---- options ----

static int number(const char *name, const char *text, unsigned least, unsigned most, unsigned *out) {
    char *end;
    errno = 0;
    const unsigned long value = strtoul(text, &end, 10);
    if (*text >= '0' && *text <= '9' && *end == '\0' && errno == 0 && value >= least && value <= most) {
        *out = (unsigned)value;
        return 0;
    }
    fprintf(stderr, NAME "--%s '%s': expected a number from %u to %u\n", name, text, least, most);
    return USAGE_CODE;
}

static int read_options(int count, char **words, struct options *out) {
    static const struct option known[] = {
        {"interface", required_argument, NULL, 'i'}, {"domain", required_argument, NULL, 'd'},
        {"bind", required_argument, NULL, 'b'},      {"port", required_argument, NULL, 'p'},
        {"armed-flag", required_argument, NULL, 'f'}, {"help", no_argument, NULL, 'h'},
        {NULL, 0, NULL, 0},
    };
    int letter, code = 0;
    opterr = 0;
    while (code == 0 && (letter = getopt_long(count, words, ":", known, NULL)) != -1) {
        switch (letter) {
            case 'i': out->interface = optarg; break;
            case 'd': code = number("domain", optarg, 0, 230, &out->domain); break;
            case 'b': out->bind = optarg; break;
            case 'p': code = number("port", optarg, 1, 65535, &out->port); break;
            case 'f': out->armed_flag = optarg; break;
            case 'h': fputs(HELP, stdout); exit(0);
            default:
                fprintf(stderr, NAME "%s '%s'; --help lists the options\n",
                        letter == ':' ? "a value is missing after" : "there is no option", words[optind - 1]);
                code = USAGE_CODE;
        }
    }
    if (code == 0 && optind < count) {
        fprintf(stderr, NAME "unexpected '%s'; --help lists the options\n", words[optind]);
        code = USAGE_CODE;
    }
    return code;
}

// ---- what is asked of the system ----

static bool become_realtime(void) {
    const struct sched_param wanted = {.sched_priority = PRIORITY};
    const int code = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);  // threads of DDS inherit it
    if (code != 0)
        fprintf(stderr, NAME "real-time priority refused (%s): on a busy machine it is late; see LimitRTPRIO in "
                        "g1-guard.service\n", strerror(code));
    return code == 0;
}

// After DDS has its memory: a limit that counts what comes later would make that fail.
static void lock_memory(void) {
#ifndef __SANITIZE_ADDRESS__  // whose memory is not all to be locked
    if (mlockall(MCL_CURRENT | MCL_ONFAULT) != 0)
        fprintf(stderr, NAME "memory is not locked (%s); see LimitMEMLOCK in g1-guard.service\n", strerror(errno));
#endif
}

static int open_socket(const struct options *options) {
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_port = htons((uint16_t)options->port)};
    if (inet_pton(AF_INET, options->bind, &here.sin_addr) != 1) {
        fprintf(stderr, NAME "--bind '%s': expected an IPv4 address such as 127.0.0.1\n", options->bind);
        return -1;
    }
    const int made = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (made < 0 || bind(made, (struct sockaddr *)&here, sizeof here) != 0) {
        fprintf(stderr, NAME "%s port %u: %s%s\n", options->bind, options->port, strerror(errno),
                errno == EADDRINUSE ? "; another guard? `ss -ulpn` shows who has it" : "");
        if (made >= 0) close(made);
        return -1;
    }
    return made;
}

// A byte in a file of its own, mapped: what is written there outlives a kill, and writing it never waits.
static uint8_t *open_flag(const char *path) {
    static uint8_t none;
    if (path == NULL) return &none;
    const int file = open(path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (file < 0 || ftruncate(file, 1) != 0) {
        fprintf(stderr, NAME "--armed-flag '%s': %s\n", path, strerror(errno));
        if (file >= 0) close(file);
        return NULL;
    }
    void *mapped = mmap(NULL, 1, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (mapped == MAP_FAILED) fprintf(stderr, NAME "--armed-flag '%s': %s\n", path, strerror(errno));
    return mapped == MAP_FAILED ? NULL : mapped;
}

static void on_signal(int which) {
    (void)which;
    is_told_to_end = 1;
}

static void obey_signals(void) {
    struct sigaction action = {.sa_handler = on_signal};
    sigaction(SIGTERM, &action, NULL);
    sigaction(SIGINT, &action, NULL);
    signal(SIGHUP, SIG_IGN);  // a terminal that closes does not end a guard
    signal(SIGPIPE, SIG_IGN);
}

// ---- the thread that may wait: who else writes, and what the log says ----

static void log_change(int *state, int *reason) {
    const int new_state = atomic_load(&told_state), new_reason = atomic_load(&told_reason);
    if (new_state == *state && new_reason == *reason) return;
    *state = new_state;
    *reason = new_reason;
    struct pollfd where = {.fd = STDERR_FILENO, .events = POLLOUT};
    if (poll(&where, 1, 0) == 1) fprintf(stderr, NAME "%s%s\n", STATE_WORDS[new_state], REASON_WORDS[new_reason]);
}

static void *housekeeping(void *unused) {
    int state = STATE_WAITING, reason = REASON_NONE;
    struct foreign_writer found;
    while (!atomic_load(&is_over)) {
        if (robot_discover(&found)) {
            pthread_mutex_lock(&foreign_lock);
            foreign = found;
            foreign_is_new = true;
            pthread_mutex_unlock(&foreign_lock);
        }
        log_change(&state, &reason);
    }
    return unused;
}

static bool start_housekeeping(pthread_t *thread) {
    const struct sched_param plain = {.sched_priority = 0};
    pthread_attr_t attributes;
    pthread_attr_init(&attributes);
    pthread_attr_setinheritsched(&attributes, PTHREAD_EXPLICIT_SCHED);
    pthread_attr_setschedpolicy(&attributes, SCHED_OTHER);
    pthread_attr_setschedparam(&attributes, &plain);
    const int code = pthread_create(thread, &attributes, housekeeping, NULL);
    if (code != 0) fprintf(stderr, NAME "no thread (%s)\n", strerror(code));
    return code == 0;
}

// ---- the loop ----

static void send_answer(int sock, uint64_t to, const struct answer *answer) {
    struct sockaddr_in where = {.sin_family = AF_INET, .sin_port = htons((uint16_t)(to & 0xFFFF))};
    where.sin_addr.s_addr = htonl((uint32_t)(to >> 16));
    (void)sendto(sock, answer, sizeof *answer, MSG_DONTWAIT, (struct sockaddr *)&where, sizeof where);
}

static void take_datagrams(struct guard *guard, int sock) {
    uint8_t data[COMMAND_SIZE + 1];  // one more, so that a longer one is seen to be longer
    struct answer reply;
    for (int i = 0; i < MOST_DATAGRAMS; ++i) {
        struct sockaddr_in from;
        socklen_t length = sizeof from;
        const ssize_t size = recvfrom(sock, data, sizeof data, MSG_DONTWAIT, (struct sockaddr *)&from, &length);
        if (size < 0) return;
        const uint64_t address = (uint64_t)ntohl(from.sin_addr.s_addr) << 16 | ntohs(from.sin_port);
        if (guard_on_datagram(guard, now_ns(), data, (size_t)size, address, &reply)) send_answer(sock, address, &reply);
    }
}

static void take_states(struct guard *guard) {
    struct robot_state states[MOST_STATES];
    int damaged;
    const int good = robot_take(states, &damaged);
    for (int i = 0; i < damaged; ++i) guard_on_bad_state(guard);
    for (int i = 0; i < good; ++i) guard_on_state(guard, now_ns(), &states[i]);
}

static void take_foreign(struct guard *guard) {
    if (pthread_mutex_trylock(&foreign_lock) != 0) return;
    if (foreign_is_new) guard_on_foreign(guard, &foreign);
    foreign_is_new = false;
    pthread_mutex_unlock(&foreign_lock);
}

static void tick(struct guard *guard, int sock, long count) {
    struct motor_command command;
    struct answer status;
    take_states(guard);
    take_foreign(guard);
    take_datagrams(guard, sock);
    if (is_told_to_end) guard_end(guard, now_ns());
    if (guard_step(guard, now_ns(), &command) && !robot_send(&command)) ++guard->failed_sends;
    const uint64_t to = guard_listener(guard, now_ns());
    if (count % STEPS_PER_STATUS != 0 || to == 0) return;
    guard_status(guard, now_ns(), &status);
    send_answer(sock, to, &status);
}

static void sleep_until(int64_t at_ns) {
    const struct timespec at = {.tv_sec = at_ns / 1000000000LL, .tv_nsec = at_ns % 1000000000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) == EINTR) {}
}

// Whether a datagram came before an instant.
static bool is_asked_before(int64_t at_ns, int sock) {
    struct pollfd asked = {.fd = sock, .events = POLLIN};
    const int64_t left_ns = at_ns - now_ns();
    const struct timespec left = {.tv_sec = left_ns / 1000000000LL, .tv_nsec = left_ns % 1000000000LL};
    return left_ns > 0 && ppoll(&asked, 1, &left, NULL) == 1;
}

// A step every period. A command does not wait for the next: it begins a period, and not again before one without.
static void run(struct guard *guard, int sock, uint8_t *armed_flag) {
    int64_t next_ns = now_ns();
    bool is_early = false;
    for (long count = 0; !guard_is_done(guard, now_ns()); ++count) {
        tick(guard, sock, count);
        *(volatile uint8_t *)armed_flag = guard->state != STATE_WAITING;
        atomic_store(&told_state, guard->state);
        atomic_store(&told_reason, guard->reason);
        next_ns += PERIOD_NS;
        if (next_ns < now_ns()) next_ns = now_ns();  // what was missed is not caught up with
        is_early = !is_early && is_asked_before(next_ns, sock);
        if (is_early) next_ns = now_ns();
        else sleep_until(next_ns);
    }
    *(volatile uint8_t *)armed_flag = 0;
}

int main(int count, char **words) {
    static struct guard guard;
    struct options options = {.interface = "lo", .bind = "127.0.0.1", .port = 47029};
    pthread_t housekeeper;
    const int code = read_options(count, words, &options);
    if (code != 0) return code;
    crc_init();
    obey_signals();
    const int sock = open_socket(&options);
    uint8_t *armed_flag = sock < 0 ? NULL : open_flag(options.armed_flag);
    if (armed_flag == NULL) return 1;
    const bool is_realtime = become_realtime();
    if (!robot_open(options.interface, options.domain) || !start_housekeeping(&housekeeper)) return 1;
    lock_memory();
    fprintf(stderr, NAME "listens on %s port %u, robot on %s, domain %u\n", options.bind, options.port,
            options.interface, options.domain);
    guard_init(&guard, now_ns(), *armed_flag != 0, draw);
    guard.is_realtime = is_realtime;
    run(&guard, sock, armed_flag);
    atomic_store(&is_over, 1);
    pthread_join(housekeeper, NULL);
    robot_close();
    return 0;
}
