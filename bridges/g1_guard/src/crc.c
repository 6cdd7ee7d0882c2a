#include "crc.h"

static uint32_t reflected[256], straight[256];

void crc_init(void) {
    for (uint32_t byte = 0; byte < 256; ++byte) {
        uint32_t low = byte, high = byte << 24;
        for (int bit = 0; bit < 8; ++bit) {
            low = (low >> 1) ^ ((low & 1) ? 0xEDB88320u : 0);
            high = (high << 1) ^ ((high & 0x80000000u) ? 0x04C11DB7u : 0);
        }
        reflected[byte] = low;
        straight[byte] = high;
    }
}

uint32_t crc32_zlib(const void *data, size_t size) {
    const uint8_t *bytes = data;
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < size; ++i) crc = (crc >> 8) ^ reflected[(crc ^ bytes[i]) & 0xFF];
    return ~crc;
}

uint32_t crc32_unitree(const void *words, size_t size) {
    const uint8_t *bytes = words;
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t word = 0; word + 4 <= size; word += 4)
        for (size_t i = 4; i-- > 0;)  // the last byte of a little-endian word is its most significant
            crc = (crc << 8) ^ straight[(crc >> 24) ^ bytes[word + i]];
    return crc;
}
