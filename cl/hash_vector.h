// Philox-4x32-10 (hash.h) of VECTOR counters at a time that differ in their first word.

#ifndef AMSLICER_HASH_VECTOR_H
#define AMSLICER_HASH_VECTOR_H

#include "tile.h"

#define uintV CAT(uint, VECTOR)

// words: the counters, which the random words replace.
void philox4x32V(uintV words[4], uint2 key)
{
    for (int round = 0; round < 10; ++round) {
        const uintV low0 = 0xD2511F53u * words[0];
        const uintV high0 = mul_hi((uintV)0xD2511F53u, words[0]);
        const uintV low1 = 0xCD9E8D57u * words[2];
        const uintV high1 = mul_hi((uintV)0xCD9E8D57u, words[2]);
        words[0] = high1 ^ words[1] ^ key.x;
        words[1] = low1;
        words[2] = high0 ^ words[3] ^ key.y;
        words[3] = low0;
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
}

#endif
