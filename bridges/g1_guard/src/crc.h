// Two checksums: zlib's of datagrams, and the one that Unitree makes of the words of a struct.
#ifndef G1_GUARD_CRC_H
#define G1_GUARD_CRC_H

#include <stddef.h>
#include <stdint.h>

void crc_init(void);  // fills the tables; before anything else

uint32_t crc32_zlib(const void *data, size_t size);

// Of little-endian words, most significant bit first: polynomial 0x04C11DB7, from 0xFFFFFFFF, neither reflected nor
// inverted at the end. `size` is a multiple of four. Source: crc.h of unitreerobotics/unitree_sdk2.
uint32_t crc32_unitree(const void *words, size_t size);

#endif
