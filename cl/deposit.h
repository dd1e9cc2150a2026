// From G to bitmaps of the materials: a solid pixel's material is 1 + the number of thresholds that the phase is beyond. A
// threshold is the profile's key (amslicer/profiles/key.py) at a cumulative ratio; beyond 1 or -3 it is a plain fill. The
// host defines CYCLIC; VALUE: Re G (1) or |G|² (2) is read, thresholds are values of it, and a pixel is beyond those that are
// not below its own; TABLE, or 0: a pixel's rank is looked up among so many (amslicer/profiles/rank.py), and it is beyond the thresholds
// that are not above its rank; BLENDED: a last plane of thresholds says in which row of the table; and DITHERED: each pixel
// reads G at a random place within itself. With GRADED, so many cumulative ratios come as such (graded.h), and are added up.

#ifndef AMSLICER_DEPOSIT_H
#define AMSLICER_DEPOSIT_H

#include "tile.h"
#if GRADED
#include "graded.h"
#else
#define intV CAT(int, VECTOR)
#endif
#if DITHERED
#include "hash_vector.h"
#endif

#define ucharV CAT(uchar, VECTOR)
#define to_intV CAT(convert_int, VECTOR)
#define to_ucharV CAT(convert_uchar, VECTOR)
#define to_floatV CAT(convert_float, VECTOR)

#if DITHERED
// The phase from the pixel's centre to its random place: wave is rad per column, row and layer. The hash has 32 bits and
// a float 24: uniform in (-½, ½) is enough.
floatV jitter(const int column, const uint row, const uint layer, const float4 wave, const uint number, const uint2 seed)
{
    uintV words[4];
    for (int i = 0; i < VECTOR; ++i) ((uint *)&words[0])[i] = (uint)(column + i);
    words[1] = (uintV)row;
    words[2] = (uintV)layer;
    words[3] = (uintV)number;
    philox4x32V(words, seed);
    floatV phase = (floatV)0.0f;
    const float along[3] = {wave.x, wave.y, wave.z};
    for (int axis = 0; axis < 3; ++axis)
        phase = fma((floatV)along[axis], fma(to_floatV(words[axis]), (floatV)0x1p-32f, (floatV)-0.5f), phase);
    return phase;
}
#endif

// What the pixels of a job share: thresholds: [planes][padded rows][padded columns]; padded: columns, rows; ranks: [rows]
// [TABLE], over the stand-in for the angle or over values from -reach to reach; number and seed: of the hash; planar: a 2D
// pattern's layers all count as the first.
typedef struct {
    global const float *thresholds;
    global const float *ranks;
    float reach;
    uint planes;
    uint2 padded;
    uint2 seed;
    uint number;
    uint planar;
} Profile;

// Where a vector of lanes is -1, as bits, the first lane's the highest: a byte per 8 lanes.
void pack(const intV lanes, uchar bits[VECTOR / 8])
{
    const ucharV ones = to_ucharV(lanes & 1);
    for (int i = 0; i < VECTOR / 8; ++i)
        bits[i] = (uchar)((((const ulong *)&ones)[i] * 0x8040201008040201UL) >> 56);
}

#if TABLE
// The rank of each of a vector of pixels; row: of the table.
floatV rank_of(const floatV re, const floatV im, const Profile profile, const floatV row)
{
#if VALUE
    const floatV place = fma(re, (floatV)(0.5f / profile.reach), (floatV)0.5f) * (float)TABLE;
#else
    const floatV size = fabs(re) + fabs(im), turned = re / fmax(size, (floatV)FLT_MIN);
    floatV angle = select((floatV)3.0f + turned, (floatV)1.0f - turned, im >= 0.0f);
    angle = select(angle, (floatV)2.0f, size == 0.0f);
    const floatV place = angle * (0.25f * TABLE);
#endif
    const intV entry = to_intV(clamp(place, (floatV)0.0f, (floatV)(TABLE - 1))) + to_intV(row) * TABLE;
    floatV rank;
    for (int i = 0; i < VECTOR; ++i) ((float *)&rank)[i] = profile.ranks[((const int *)&entry)[i]];
    return rank;
}
#endif

// The bitmaps of a vector of pixels of one row from G there. deposits: [material][padded rows][bytes] and solid:
// [padded rows][bytes] of a layer; column, row: of the first pixel; wave: rad per column, row and layer; layer: the part's.
void deposit(floatV re, floatV im, global const uchar *solid, global uchar *deposits, const Profile profile,
             const int column, const uint row, const uint layer, const float4 wave
#if GRADED
             , const floatV ratios[GRADED], floatV sums[GRADED]
#endif
)
{
#if DITHERED
    const floatV phase = jitter(column, row, profile.planar ? 0u : layer, wave, profile.number, profile.seed);
    floatV cosine_of;
    const floatV sine_of = sincos(phase, &cosine_of);
    const floatV turned = fma(re, cosine_of, -im * sine_of);
    im = fma(re, sine_of, im * cosine_of);
    re = turned;
#endif
#if VALUE == 2
    re = fma(re, re, im * im);
#endif
#if !VALUE && !TABLE
    const floatV power = fma(re, re, im * im);
    floatV key = re * fabs(re);
#if CYCLIC
    key = select(key, -2.0f * power - key, im < 0.0f);
#endif
#endif
    const size_t plane = (size_t)profile.padded.x * profile.padded.y;
    const size_t place = (size_t)row * profile.padded.x + (size_t)column;
    intV material = (intV)0;
#if TABLE
#if BLENDED
    const floatV line = vloadV(0, profile.thresholds + profile.planes * plane + place);
#else
    const floatV line = (floatV)0.0f;
#endif
    const floatV rank = rank_of(re, im, profile, line);
#endif
    for (uint p = 0; p < profile.planes; ++p) {
#if GRADED
        const floatV threshold = key_of(ratios[p]);
#else
        const floatV threshold = vloadV(0, profile.thresholds + p * plane + place);
#endif
#if TABLE
        material -= rank >= threshold;
#elif VALUE
        material -= re <= threshold;
#else
        material -= (threshold > 1.0f) | ((threshold >= -3.0f) & (key <= threshold * power));
#endif
    }
    uchar rest[VECTOR / 8];
    for (int i = 0; i < VECTOR / 8; ++i) rest[i] = solid[place / 8 + i];
#if GRADED
    uint all = 0xFF;
    for (int i = 0; i < VECTOR / 8; ++i) all &= rest[i];
    intV inside = (intV)-1;
    if (all != 0xFF)  // seldom: bits to lanes is slow
        for (int i = 0; i < VECTOR; ++i) ((int *)&inside)[i] = -((rest[i / 8] >> (7 - i % 8)) & 1);
    for (int p = 0; p < GRADED; ++p) sums[p] += select((floatV)0.0f, ratios[p], inside);
#endif
    for (uint m = 0; m < profile.planes; ++m) {
        uchar bits[VECTOR / 8];
        pack(material == (intV)(int)m, bits);
        for (int i = 0; i < VECTOR / 8; ++i) {
            deposits[(m * plane + place) / 8 + i] = bits[i] & rest[i];
            rest[i] &= ~bits[i];
        }
    }
    for (int i = 0; i < VECTOR / 8; ++i) deposits[(profile.planes * plane + place) / 8 + i] = rest[i];
}

#endif
