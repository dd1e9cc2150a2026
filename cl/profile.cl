// The materials' bitmaps of pixels whose G is known one by one.

#include "deposit.h"

// deposits: [layer][material][padded rows][bytes] and solid: [layer][padded rows][bytes], a bit per pixel; field as
// rank1.cl leaves it; tiles: (column, row) and slots: place in the field of each tile; thresholds:
// [planes][padded rows][padded columns]; first: the layer of deposits and solid that the field's first layer is;
// waves: of each tile, rad per column, row and layer; number: of the hash's counter; first_layer: the part's layer that the hash counts the first one as (a planar pattern's all count as one).
kernel void profile(global uchar *restrict deposits, global const float *restrict field,
                    global const uchar *restrict solid, global const float *restrict thresholds,
                    global const float *restrict ranks, const float reach,
                    global const int2 *restrict tiles, global const uint *restrict slots,
                    const uint planes, const uint2 padded, const uint field_tiles,
                    const uint field_layers, const uint first, global const float4 *restrict waves,
                    const uint2 seed, const uint number, const uint first_layer, const uint planar)
{
    const uint row = (uint)get_global_id(0);
    const uint tile_index = (uint)get_global_id(1);
    const uint layer = (uint)get_global_id(2);
    const int2 corner = tiles[tile_index] * TILE;
    const uint down = (uint)corner.y + row;
    const size_t slot = (size_t)((first + layer) % field_layers) * field_tiles + slots[tile_index];
    global const float *g = field + (slot * TILE + row) * 2 * TILE;
    const size_t bytes = (size_t)(first + layer) * padded.x * padded.y / 8;
    const Profile profile = {thresholds, ranks, reach, planes, padded, seed, number, planar};
    for (int v = 0; v < TILE; v += VECTOR)
        deposit(vloadV(0, g + v), vloadV(0, g + TILE + v), solid + bytes, deposits + (planes + 1) * bytes, profile,
                corner.x + v, down, first_layer + layer, waves[tile_index]);
}
