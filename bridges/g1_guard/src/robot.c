#include "robot.h"

#include <dds/dds.h>
#include <net/if.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "crc.h"
#include "unitree_hg.h"

#define COMMAND_TOPIC "rt/lowcmd"
#define STATE_TOPIC "rt/lowstate"
#define MOST_DISCOVERED 1024
#define LOOPBACK "lo"

typedef unitree_hg_msg_dds__LowCmd_ low_cmd;
typedef unitree_hg_msg_dds__LowState_ low_state;
typedef unitree_hg_msg_dds__MotorState_ motor_state;

// The checksum is made over the structs as C lays them out, padding included, which is zero.
_Static_assert(sizeof(low_cmd) == 1004 && sizeof(low_state) == 2092, "the layout that the checksum is made over");

static dds_entity_t participant, reader, writer, publications, participants, news;
static dds_guid_t own;
static low_state taken[MOST_STATES];
static low_cmd command;

// One interface alone; loopback has no multicast.
static int describe(char *out, size_t size, const char *interface) {
    const bool is_local = strcmp(interface, LOOPBACK) == 0;
    return snprintf(out, size,
                    "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface name=\"%s\" "
                    "multicast=\"%s\"/></Interfaces>%s</General>%s</Domain></CycloneDDS>",
                    interface, is_local ? "false" : "default",
                    is_local ? "<AllowMulticast>false</AllowMulticast>" : "",
                    is_local ? "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
                               "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>"
                               "<Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery>"
                             : "");
}

static bool fail(const char *interface, const char *what, int code) {
    fprintf(stderr, "g1-guard: interface '%s': %s (%s); is it up, and does it have an address? `ip -br address` lists "
                    "interfaces\n", interface, what, dds_strretcode(-code));
    return false;
}

static void drop_log(void *user, const dds_log_data_t *data) {
    (void)user;
    (void)data;
}

static dds_entity_t make_writer(void) {
    dds_qos_t *qos = dds_create_qos();
    const dds_entity_t topic =
        dds_create_topic(participant, &unitree_hg_msg_dds__LowCmd__desc, COMMAND_TOPIC, NULL, NULL);
    dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, 0);  // the newest counts: never wait for a reader
    dds_qset_durability(qos, DDS_DURABILITY_VOLATILE);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 1);
    const dds_entity_t made = topic < 0 ? topic : dds_create_writer(participant, topic, qos, NULL);
    dds_delete_qos(qos);
    return made;
}

static dds_entity_t make_reader(void) {
    dds_qos_t *qos = dds_create_qos();
    const dds_entity_t topic =
        dds_create_topic(participant, &unitree_hg_msg_dds__LowState__desc, STATE_TOPIC, NULL, NULL);
    dds_qset_reliability(qos, DDS_RELIABILITY_BEST_EFFORT, 0);
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, MOST_STATES);
    dds_qset_type_consistency(qos, DDS_TYPE_CONSISTENCY_DISALLOW_TYPE_COERCION, false, false, false, false, false);
    const dds_entity_t made = topic < 0 ? topic : dds_create_reader(participant, topic, qos, NULL);
    dds_delete_qos(qos);
    return made;
}

static bool watch_discovery(void) {
    publications = dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, NULL, NULL);
    participants = dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPARTICIPANT, NULL, NULL);
    news = dds_create_waitset(participant);
    return publications > 0 && participants > 0 && news > 0 &&
           dds_set_status_mask(publications, DDS_DATA_AVAILABLE_STATUS) == 0 &&
           dds_waitset_attach(news, publications, 0) == 0;
}

bool robot_open(const char *interface, unsigned domain) {
    char config[1024];
    if (if_nametoindex(interface) == 0)
        return fail(interface, "there is none of this name", -DDS_RETCODE_BAD_PARAMETER);
    describe(config, sizeof config, interface);
    dds_set_log_sink(drop_log, NULL);  // one line of ours says it
    const dds_entity_t opened = dds_create_domain(domain, config);
    participant = opened < 0 ? opened : dds_create_participant(domain, NULL, NULL);
    if (participant < 0) return fail(interface, "DDS cannot use it", participant);
    dds_get_guid(participant, &own);
    reader = make_reader();
    writer = make_writer();
    if (reader < 0 || writer < 0 || !watch_discovery()) return fail(interface, "DDS has no reader or writer", reader);
    return true;
}

void robot_close(void) { dds_delete(DDS_CYCLONEDDS_HANDLE); }

// ---- messages ----

// Copies members one by one over zeros, so that padding is zero whatever DDS left in it.
static uint32_t checksum_of_state(const low_state *state) {
    static low_state clean;
    clean.version[0] = state->version[0];
    clean.version[1] = state->version[1];
    clean.mode_pr = state->mode_pr;
    clean.mode_machine = state->mode_machine;
    clean.tick = state->tick;
    memcpy(&clean.imu_state, &state->imu_state,
           offsetof(unitree_hg_msg_dds__IMUState_, temperature) + sizeof state->imu_state.temperature);
    for (int i = 0; i < 35; ++i) {
        const size_t numbers = offsetof(motor_state, q);
        clean.motor_state[i].mode = state->motor_state[i].mode;
        memcpy((char *)&clean.motor_state[i] + numbers, (const char *)&state->motor_state[i] + numbers,
               sizeof(motor_state) - numbers);
    }
    memcpy(clean.wireless_remote, state->wireless_remote, sizeof clean.wireless_remote);
    memcpy(clean.reserve, state->reserve, sizeof clean.reserve);
    return crc32_unitree(&clean, offsetof(low_state, crc));
}

static void convert(const low_state *from, struct robot_state *to) {
    to->mode_machine = from->mode_machine;
    to->tick = from->tick;
    memcpy(to->remote, from->wireless_remote, sizeof to->remote);
    memcpy(to->quat_wxyz, from->imu_state.quaternion, sizeof to->quat_wxyz);
    for (int i = 0; i < MOTORS; ++i) {
        to->q[i] = from->motor_state[i].q;
        to->error[i] = from->motor_state[i].motorstate;
        to->temperature[i][0] = from->motor_state[i].temperature[0];
        to->temperature[i][1] = from->motor_state[i].temperature[1];
    }
}

int robot_take(struct robot_state states[MOST_STATES], int *damaged) {
    void *samples[MOST_STATES];
    dds_sample_info_t infos[MOST_STATES];
    int good = 0;
    *damaged = 0;
    for (int i = 0; i < MOST_STATES; ++i) samples[i] = &taken[i];
    const dds_return_t came = dds_take(reader, samples, infos, MOST_STATES, MOST_STATES);
    for (int i = 0; i < came; ++i) {
        if (!infos[i].valid_data) continue;
        if (checksum_of_state(&taken[i]) == taken[i].crc) convert(&taken[i], &states[good++]);
        else ++*damaged;
    }
    return good;
}

bool robot_send(const struct motor_command *wanted) {
    command.mode_machine = wanted->mode_machine;
    for (int i = 0; i < MOTORS; ++i) {
        command.motor_cmd[i].mode = wanted->mode[i];
        command.motor_cmd[i].q = wanted->targets.q[i];
        command.motor_cmd[i].kp = wanted->targets.kp[i];
        command.motor_cmd[i].kd = wanted->targets.kd[i];
    }
    command.crc = crc32_unitree(&command, offsetof(low_cmd, crc));
    return dds_write(writer, &command) == DDS_RETCODE_OK;
}

// ---- who else writes ----

static int read_alive(dds_entity_t from, void *samples[MOST_DISCOVERED]) {
    static dds_sample_info_t infos[MOST_DISCOVERED];
    samples[0] = NULL;  // lent by DDS
    return dds_read_mask(from, samples, infos, MOST_DISCOVERED, MOST_DISCOVERED,
                         DDS_ANY_SAMPLE_STATE | DDS_ANY_VIEW_STATE | DDS_ALIVE_INSTANCE_STATE);
}

static void copy_property(const dds_qos_t *qos, const char *name, char *out, size_t size) {
    char *value = NULL;
    if (!dds_qget_prop(qos, name, &value) || value == NULL) return;
    snprintf(out, size, "%s", value);
    dds_free(value);
}

static void say_who(const dds_guid_t *key, struct foreign_writer *out) {
    static void *samples[MOST_DISCOVERED];
    char pid[16] = "";
    const int count = read_alive(participants, samples);
    for (int i = 0; i < count; ++i) {
        const dds_builtintopic_participant_t *found = samples[i];
        if (memcmp(&found->key, key, sizeof *key) != 0) continue;
        copy_property(found->qos, "__Hostname", out->host, sizeof out->host);
        copy_property(found->qos, "__ProcessName", out->process, sizeof out->process);
        copy_property(found->qos, "__Pid", pid, sizeof pid);
        out->pid = atoi(pid);
    }
    if (count > 0) dds_return_loan(participants, samples, count);
}

bool robot_discover(struct foreign_writer *out) {
    static void *samples[MOST_DISCOVERED];
    dds_attach_t triggered;
    if (dds_waitset_wait(news, &triggered, 1, DDS_MSECS(100)) < 1) return false;
    uint32_t status;
    dds_take_status(publications, &status, DDS_DATA_AVAILABLE_STATUS);
    memset(out, 0, sizeof *out);
    const int count = read_alive(publications, samples);
    for (int i = 0; i < count && !out->is_there; ++i) {
        const dds_builtintopic_endpoint_t *found = samples[i];
        if (strcmp(found->topic_name, COMMAND_TOPIC) != 0) continue;
        if (memcmp(&found->participant_key, &own, sizeof own) == 0) continue;
        out->is_there = true;
        say_who(&found->participant_key, out);
    }
    if (count > 0) dds_return_loan(publications, samples, count);
    return true;
}
