// The weight of kernels whose envelope depends on the distance alone: a table of w over (|d|/radius)² from 0 to 1.

#ifndef AMSLICER_ENVELOPE_H
#define AMSLICER_ENVELOPE_H

#include "tile.h"

#define intV CAT(int, VECTOR)
#define to_intV CAT(convert_int, VECTOR)
#define to_floatV CAT(convert_float, VECTOR)

// Of a vector of nodes dx away along x, between the table's samples + 2 values; yz: what y and z add to (|d|/radius)²,
// below 1; scale: 1/radius².
floatV weight_of(const floatV dx, const float yz, const float scale, global const float *envelope, const uint samples)
{
    const floatV q = fmin(fma(dx * dx, (floatV)scale, (floatV)yz), (floatV)1.0f) * (float)samples;
    const intV place = to_intV(q);
    floatV low, high;
    for (int i = 0; i < VECTOR; ++i) {
        ((float *)&low)[i] = envelope[((const int *)&place)[i]];
        ((float *)&high)[i] = envelope[((const int *)&place)[i] + 1];
    }
    return fma(q - to_floatV(place), high - low, low);
}

#endif
