// From G to material labels: 0 where the part is not solid, else 1 + the number of thresholds that the phase
// is beyond. A threshold is the profile's key (amslicer/profile.py) at a cumulative ratio; beyond 1 or -3 it is a plain
// fill. The host defines CYCLIC, and DITHERED: each pixel reads the phase at a random place within itself.

#include "tile.h"
#if DITHERED
#include "hash_vector.h"
#endif

#define intV CAT(int, VECTOR)
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

// labels, solid: [layer][padded rows][padded columns]; field as rank1.cl leaves it; tiles: (column, row) and
// slots: place in the field of each tile; thresholds: [planes][padded rows][padded columns]; first: the layer of labels and
// solid that the field's first layer is; waves: of each tile, rad per column, row and layer; number: of the hash's
// counter; first_layer: the part's layer that the hash counts the first one as (a planar pattern's all count as one).
kernel void profile(global uchar *restrict labels, global const float *restrict field,
                    global const uchar *restrict solid, global const float *restrict thresholds,
                    global const int2 *restrict tiles, global const uint *restrict slots,
                    const uint planes, const uint2 padded, const uint field_tiles,
                    const uint field_layers, const uint first, global const float4 *restrict waves,
                    const uint2 seed, const uint number, const uint first_layer, const uint planar)
{
    const uint row = (uint)get_global_id(0);
    const uint tile_index = (uint)get_global_id(1);
    const uint layer = (uint)get_global_id(2);
    const int2 tile = tiles[tile_index];
    const size_t slot = (size_t)((first + layer) % field_layers) * field_tiles + slots[tile_index];
    global const float *g = field + (slot * TILE + row) * 2 * TILE;
    const size_t in_plane = ((size_t)tile.y * TILE + row) * padded.x + (size_t)tile.x * TILE;
    const size_t here = (size_t)(first + layer) * padded.x * padded.y + in_plane;
    for (int v = 0; v < TILE / VECTOR; ++v) {
        floatV re = vloadV(v, g);
        floatV im = vloadV(v, g + TILE);
#if DITHERED
        const floatV phase = jitter(tile.x * TILE + v * VECTOR, (uint)(tile.y * TILE) + row,
                                    planar ? 0u : first_layer + layer, waves[tile_index], number, seed);
        floatV cosine_of;
        const floatV sine_of = sincos(phase, &cosine_of);
        const floatV turned = fma(re, cosine_of, -im * sine_of);
        im = fma(re, sine_of, im * cosine_of);
        re = turned;
#endif
        const floatV power = fma(re, re, im * im);
        floatV key = re * fabs(re);
#if CYCLIC
        key = select(key, -2.0f * power - key, im < 0.0f);
#endif
        intV label = (intV)1;
        for (uint p = 0; p < planes; ++p) {
            const floatV threshold = vloadV(v, thresholds + (size_t)p * padded.x * padded.y + in_plane);
            label -= (threshold > 1.0f) | ((threshold >= -3.0f) & (key <= threshold * power));
        }
        const intV inside = to_intV(vloadV(v, solid + here)) != 0;
        vstoreV(to_ucharV(label & inside), v, labels + here);
    }
}
