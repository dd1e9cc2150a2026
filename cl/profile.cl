// From G to material labels: 0 where the part is not solid, else 1 + the number of thresholds that the phase
// is beyond. A threshold is cos(πc)·|cos(πc)| of a cumulative ratio c; beyond ±1 it is a plain fill.

#include "tile.h"

#define intV CAT(int, VECTOR)
#define ucharV CAT(uchar, VECTOR)
#define to_intV CAT(convert_int, VECTOR)
#define to_ucharV CAT(convert_uchar, VECTOR)

// labels, solid: [layer][padded rows][padded columns]; field as rank1.cl leaves it; tiles: (column, row) and
// slots: place in the field of each tile; thresholds: [planes][padded rows][padded columns]; first:
// the layer of labels and solid that the field's first layer is.
kernel void profile(global uchar *restrict labels, global const float *restrict field,
                    global const uchar *restrict solid, global const float *restrict thresholds,
                    global const int2 *restrict tiles, global const uint *restrict slots,
                    const uint planes, const uint2 padded, const uint field_tiles,
                    const uint field_layers, const uint first)
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
        const floatV re = vloadV(v, g);
        const floatV im = vloadV(v, g + TILE);
        const floatV cosine = re * fabs(re);
        const floatV power = fma(re, re, im * im);
        intV label = (intV)1;
        for (uint p = 0; p < planes; ++p) {
            const floatV threshold = vloadV(v, thresholds + (size_t)p * padded.x * padded.y + in_plane);
            label -= (threshold > 1.0f) | ((threshold >= -1.0f) & (cosine <= threshold * power));
        }
        const intV inside = to_intV(vloadV(v, solid + here)) != 0;
        vstoreV(to_ucharV(label & inside), v, labels + here);
    }
}
