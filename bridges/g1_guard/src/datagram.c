#include "datagram.h"

#include <string.h>

#include "crc.h"

enum refusal datagram_read(const uint8_t *data, size_t size, struct request *out) {
    uint32_t crc;
    if (size != SHORT_SIZE && size != COMMAND_SIZE) return REFUSED_SIZE;
    memcpy(&out->head, data, sizeof out->head);
    if (memcmp(out->head.magic, REQUEST_MAGIC, sizeof out->head.magic) != 0) return REFUSED_MAGIC;
    if (out->head.version != DATAGRAM_VERSION) return REFUSED_VERSION;
    if (out->head.size != size) return REFUSED_SIZE;
    memcpy(&crc, data + size - CRC_SIZE, CRC_SIZE);
    if (crc != crc32_zlib(data, size - CRC_SIZE)) return REFUSED_CRC;
    if (out->head.kind < KIND_HELLO || out->head.kind >= KINDS) return REFUSED_KIND;
    if ((out->head.kind == KIND_COMMAND) != (size == COMMAND_SIZE)) return REFUSED_SIZE;
    if (size == COMMAND_SIZE) memcpy(&out->targets, data + sizeof out->head, sizeof out->targets);
    return NOT_REFUSED;
}

void datagram_seal(struct answer *answer) {
    memcpy(answer->magic, ANSWER_MAGIC, sizeof answer->magic);
    answer->version = DATAGRAM_VERSION;
    answer->size = sizeof *answer;
    answer->crc = crc32_zlib(answer, offsetof(struct answer, crc));
}
