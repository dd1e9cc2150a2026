// A painted ratio that is linear between texels, at the pixels of a tile, and the key that it is as a threshold
// (amslicer/profiles/key.py). The host defines CYCLIC, and GRADED: how many cumulative ratios there are.

#ifndef AMSLICER_GRADED_H
#define AMSLICER_GRADED_H

#include "tile.h"

#define intV CAT(int, VECTOR)

// cos(πc) for c in [0, 1], to 2e-7: a polynomial in the square of the distance from ½ (Chebyshev fit, error 7e-9).
floatV cosine_of_half_turns(const floatV c)
{
    const floatV t = (floatV)0.5f - c, q = t * t;
    floatV p = fma((floatV)0.07765766f, q, (floatV)-0.59829128f);
    p = fma(p, q, (floatV)2.5500774f);
    p = fma(p, q, (floatV)-5.1677103f);
    return t * fma(p, q, (floatV)3.1415927f);
}

floatV key_of(const floatV ratio)
{
#if CYCLIC
    const floatV turns = fmin(2.0f * ratio, 2.0f - 2.0f * ratio), cosine = cosine_of_half_turns(turns);
    floatV key = cosine * fabs(cosine);
    key = select(key, -2.0f - key, ratio > 0.5f);
#else
    const floatV cosine = cosine_of_half_turns(ratio);
    floatV key = cosine * fabs(cosine);
#endif
    key = select(key, (floatV)4.0f, ratio <= 0.0f);
    return select(key, (floatV)-4.0f, ratio >= 1.0f);
}

// What a tile needs of painted ratios: texels: [layer][GRADED][texel rows][texel columns]; of each pixel column the texel
// below it (the next one is above it, if only by a share of 0), of each pixel row those below and above; and the shares.
typedef struct {
    global const float *texels;
    uint2 size;
    global const int *below_x;
    global const float *share_x;
    global const int *below_y, *above_y;
    global const float *share_y;
} Painting;

// A row of texels at a tile's pixel columns.
void along_row(const Painting painting, const uint plane, const int row, const int column, floatV ratios[COLUMNS])
{
    global const float *from = painting.texels + ((size_t)plane * painting.size.y + row) * painting.size.x;
    global const int *below = painting.below_x + column;
    global const float *share = painting.share_x + column;
    float *ratio = (float *)ratios;
    for (int i = 0; i < COLUMNS * VECTOR; ++i) {
        global const float *pair = from + below[i];
        ratio[i] = fma(share[i], pair[1] - pair[0], pair[0]);
    }
}

#endif
