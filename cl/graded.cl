// A painted ratio that is linear between texels, at the pixels of one layer: its thresholds (the key of
// amslicer/profiles/key.py, as cl/deposit.h compares them), and the sum of the ratio over the solid pixels of each row.

#include "tile.h"

// The host defines CYCLIC.

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

// thresholds: [plane][rows][padded columns]; sums: [plane][rows]; wide: [texel rows][padded columns]; below, above, share: per row;
// solid: [layer][rows][bytes], a bit per pixel, the highest first. A work-item for each row; thresholds of vectors without a
// solid pixel are left as they are.
kernel void graded(global float *restrict thresholds, global float *restrict sums, global const float *restrict wide,
                   global const int *restrict below, global const int *restrict above,
                   global const float *restrict share, global const uchar *restrict solid, const uint columns,
                   const uint rows, const uint layer, const uint plane)
{
    const uint row = (uint)get_global_id(0);
    if (row >= rows) return;
    global const float *low = wide + (size_t)below[row] * columns, *high = wide + (size_t)above[row] * columns;
    global const uchar *bits = solid + ((size_t)layer * rows + row) * columns / 8;
    const floatV part = (floatV)share[row];
    floatV sum = (floatV)0.0f;
    for (uint v = 0; v < columns / VECTOR; ++v) {
        uchar here[VECTOR / 8];
        uint any = 0, all = 0xFF;
        for (int i = 0; i < VECTOR / 8; ++i) {
            here[i] = bits[v * (VECTOR / 8) + i];
            any |= here[i];
            all &= here[i];
        }
        if (!any) continue;
        const floatV a = vloadV(v, low), ratio = fma(part, vloadV(v, high) - a, a);
        vstoreV(key_of(ratio), v, thresholds + ((size_t)plane * rows + row) * columns);
        if (all == 0xFF) {  // nearly always: bits to lanes is slow
            sum += ratio;
            continue;
        }
        intV inside;
        for (int i = 0; i < VECTOR; ++i) ((int *)&inside)[i] = -((here[i / 8] >> (7 - i % 8)) & 1);
        sum += select((floatV)0.0f, ratio, inside);
    }
    float total = 0.0f;
    for (int i = 0; i < VECTOR; ++i) total += ((const float *)&sum)[i];
    sums[plane * rows + row] = total;
}
