// From G on a tile's lattice to the materials' bitmaps: interpolated along z, then x, then y, with the threshold as the last step.

#include "deposit.h"

#define VECTORS (TILE / VECTOR)

// The host defines the nodes that a pixel takes along y and z, TAPS_Y and TAPS_Z, a vector of pixels along x, TAPS_X, and the
// vectors of a tile's row, COLUMNS; ROW_GROUPS groups of a tile's rows have a bit each.
// field as rank1.cl leaves it, its first plane being number first_plane of the block; first_*, weights_*: taps of a tile's
// layers, rows, and vectors of columns; pixels: of a tile along x and y; needed: [tile][layer], one bit for each group of
// rows that has solid pixels; in_block: number of the first layer in its block. With GRADED, asked: [layer][tile][GRADED] sums
// of the ratios over the solid pixels; the others make the Painting of graded.h. The rest as in profile.cl.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void interpolate(global uchar *restrict deposits, global const float *restrict field,
                        global const uchar *restrict solid, global const float *restrict thresholds,
                        global const float *restrict ranks, const float reach,
                        global const int2 *restrict tiles, global const uint *restrict slots,
                        const uint planes, const uint2 padded, const uint field_tiles,
                        global const uchar *restrict needed, const uint needed_layers, const uint first,
                        global const float4 *restrict waves,
                        const uint2 seed, const uint number, const uint first_layer, const uint planar,
                        const int2 pixels, const uint first_plane, const uint in_block,
                        global const int *restrict first_z, global const float *restrict weights_z,
                        global const int *restrict first_y, global const float *restrict weights_y,
                        global const int *restrict first_x, global const float *restrict weights_x
#if GRADED
                        , global float *restrict asked, global const float *restrict texels, const uint2 texel_size,
                        global const int *restrict below_x, global const float *restrict share_x, global const int *restrict below_y,
                        global const int *restrict above_y, global const float *restrict share_y
#endif
)
{
    const uint layer = (uint)get_global_id(0);
    const uint tile_index = (uint)get_global_id(1);
    const uint wanted = needed[tile_index * needed_layers + first + layer];
    if (wanted == 0) return;
    const int2 corner = tiles[tile_index] * pixels;
    const Profile profile = {thresholds, ranks, reach, planes, padded, seed, number, planar};
    const float4 wave = waves[tile_index];
    const size_t bytes = (size_t)(first + layer) * padded.x * padded.y / 8;

    floatV plane[TILE][2][VECTORS];
    global const float *z = weights_z + (in_block + layer) * TAPS_Z;
    const size_t of_plane = (size_t)field_tiles * TILE * 2 * VECTORS;
    global const floatV *below = (global const floatV *)field + (size_t)slots[tile_index] * TILE * 2 * VECTORS
                                 + ((size_t)first_z[in_block + layer] - first_plane) * of_plane;
    for (int i = 0; i < TILE * 2 * VECTORS; ++i) {
        floatV sum = z[0] * below[i];
        for (int k = 1; k < TAPS_Z; ++k) sum = fma((floatV)z[k], below[k * of_plane + i], sum);
        ((floatV *)plane)[i] = sum;
    }

    floatV wide[TILE][2][COLUMNS];
    for (int v = 0; v < COLUMNS; ++v) {
        global const floatV *x = (global const floatV *)weights_x + v * TAPS_X;
        for (int row = 0; row < TILE; ++row) {
            const float *nodes = (const float *)plane[row] + first_x[v];
            floatV re = x[0] * nodes[0], im = x[0] * nodes[TILE];
            for (int k = 1; k < TAPS_X; ++k) {
                re = fma(x[k], (floatV)nodes[k], re);
                im = fma(x[k], (floatV)nodes[TILE + k], im);
            }
            wide[row][0][v] = re;
            wide[row][1][v] = im;
        }
    }

#if GRADED
    const Painting painting = {texels, texel_size, below_x, share_x, below_y, above_y, share_y};
    floatV low[GRADED][COLUMNS], high[GRADED][COLUMNS], sums[GRADED];
    for (int p = 0; p < GRADED; ++p) sums[p] = (floatV)0.0f;
    int low_row = -1, high_row = -1;
#endif
    const int group = pixels.y / ROW_GROUPS;
    for (int row = 0; row < pixels.y; ++row) {
        if (!(wanted >> (row / group) & 1u)) continue;
        global const float *y = weights_y + row * TAPS_Y;
#if GRADED
        const int below = below_y[corner.y + row], above = above_y[corner.y + row];
        const floatV share = (floatV)share_y[corner.y + row];
        for (int p = 0; p < GRADED; ++p) {
            if (below == high_row)
                for (int v = 0; v < COLUMNS; ++v) low[p][v] = high[p][v];
            else if (below != low_row)
                along_row(painting, layer * GRADED + p, below, corner.x, low[p]);
            if (above == below)
                for (int v = 0; v < COLUMNS; ++v) high[p][v] = low[p][v];
            else if (above != high_row)
                along_row(painting, layer * GRADED + p, above, corner.x, high[p]);
        }
        low_row = below;
        high_row = above;
#endif
        for (int v = 0; v < COLUMNS; ++v) {
            const floatV *nodes = wide[first_y[row]][0] + v;
            floatV re = y[0] * nodes[0], im = y[0] * nodes[COLUMNS];
            for (int k = 1; k < TAPS_Y; ++k) {
                re = fma((floatV)y[k], nodes[k * 2 * COLUMNS], re);
                im = fma((floatV)y[k], nodes[(k * 2 + 1) * COLUMNS], im);
            }
#if GRADED
            floatV ratios[GRADED];
            for (int p = 0; p < GRADED; ++p) ratios[p] = fma(share, high[p][v] - low[p][v], low[p][v]);
#endif
            deposit(re, im, solid + bytes, deposits + (planes + 1) * bytes, profile, corner.x + v * VECTOR,
                    (uint)(corner.y + row), first_layer + layer, wave
#if GRADED
                    , ratios, sums
#endif
            );
        }
    }
#if GRADED
    for (int p = 0; p < GRADED; ++p) {
        float total = 0.0f;
        for (int i = 0; i < VECTOR; ++i) total += ((const float *)&sums[p])[i];
        asked[((size_t)layer * get_global_size(1) + tile_index) * GRADED + p] = total;
    }
#endif
}
