// Philox-4x32-10 (Salmon, Moraes, Dror, Shaw 2011): a keyed bijection of 128-bit counters. Two different
// counters can never share a stream, and no state travels from one impulse to the next.

#ifndef AMSLICER_HASH_H
#define AMSLICER_HASH_H

uint4 philox4x32(uint4 counter, uint2 key)
{
    for (int round = 0; round < 10; ++round) {
        const uint low0 = 0xD2511F53u * counter.x;
        const uint high0 = mul_hi(0xD2511F53u, counter.x);
        const uint low1 = 0xCD9E8D57u * counter.z;
        const uint high1 = mul_hi(0xCD9E8D57u, counter.z);
        counter = (uint4)(high1 ^ counter.y ^ key.x, low1, high0 ^ counter.w ^ key.y, low0);
        key += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    return counter;
}

#endif
