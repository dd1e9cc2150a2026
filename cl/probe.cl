// A known answer: does this device compile, link and run what amslicer needs (vectors, fma, exp, integers)?

#include "hash.h"

kernel void probe(global uint4 *words, global float *sums)
{
    const uint i = (uint)get_global_id(0);
    words[i] = philox4x32((uint4)(i * 0xFFFFFFFFu), (uint2)(i * 0xFFFFFFFFu));
    const float16 ramp = (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const float16 v = fma(ramp, ramp, exp(-ramp));
    const float8 w = v.lo + v.hi;
    const float4 x = w.lo + w.hi;
    sums[i] = x.x + x.y + x.z + x.w;
}
