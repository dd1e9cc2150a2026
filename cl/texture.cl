// Values of a periodic texture at the nodes of tiles, bilinear between its pixels, straight between two textures.

#include "tile.h"

#define VECTORS (TILE / VECTOR)
#define intV CAT(int, VECTOR)
#define to_intV CAT(convert_int, VECTOR)
#define to_floatV CAT(convert_float, VECTOR)

// Where a tile's first node is, in pixels from the centre of the texture's first one.
typedef struct {
    int2 whole;
    float2 part;
} Place;

// field, tiles and needed as in rank1.cl, one plane at a time; lower, upper: textures of `size` columns and rows, share: from
// one to the other; steps: between nodes, in pixels; plane, planes: which of how many of the field.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void texture(global float *restrict field, global const uchar *restrict needed, global const Place *restrict places,
                    global const float *restrict lower, global const float *restrict upper, const float share,
                    const int2 size, const float2 steps, const uint first_tile, const uint plane, const uint planes)
{
    const uint tile_index = first_tile + (uint)get_global_id(0);
    const uint wanted = needed[tile_index * planes + plane];
    if (wanted == 0) return;
    const Place place = places[tile_index];
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;

    global floatV *out = (global floatV *)(field + ((size_t)plane * get_global_size(0) + get_global_id(0)) * TILE * TILE * 2);
    for (int row = 0; row < TILE; ++row) {
        if (!(wanted >> (row / ROWS) & 1u)) continue;
        const float y = fma(steps.y, (float)row, place.part.y), below = floor(y), up = y - below;
        const int r0 = (place.whole.y + (int)below) % size.y, r1 = (r0 + 1) % size.y;
        for (int v = 0; v < VECTORS; ++v) {
            const floatV x = fma(lane + (float)(v * VECTOR), (floatV)steps.x, (floatV)place.part.x), left = floor(x);
            const floatV across = x - left;
            const intV column = (to_intV(left) + place.whole.x) % size.x;
            floatV corner[4];
            for (int i = 0; i < VECTOR; ++i) {
                const int c0 = ((const int *)&column)[i], c1 = c0 + 1 == size.x ? 0 : c0 + 1;
                for (int k = 0; k < 4; ++k) {
                    const size_t at = (size_t)(k < 2 ? r0 : r1) * (size_t)size.x + (size_t)(k % 2 ? c1 : c0);
                    ((float *)&corner[k])[i] = fma(share, upper[at] - lower[at], lower[at]);
                }
            }
            const floatV low = fma(across, corner[1] - corner[0], corner[0]);
            const floatV high = fma(across, corner[3] - corner[2], corner[2]);
            out[row * 2 * VECTORS + v] = fma((floatV)up, high - low, low);
            out[(row * 2 + 1) * VECTORS + v] = (floatV)0.0f;
        }
    }
}
