// G of kernels whose envelope depends on the distance alone and is no product along the axes: at each node, the sum of
// w(|d|) exp(i(k·d + φ)) over the kernels that reach its tile.

#include "tile.h"
#include "envelope.h"

#define VECTORS (TILE / VECTOR)

// field, tiles, needed, starts, entries, axes and first_tile as in rank1.cl; kernels: (height of the block's first plane above
// the centre in mm, wave along z in rad/mm, phase in rad, radius in mm); envelope: samples + 2 values of w over (|d|/radius)²
// from 0 to 1, the last ones 0; nodes_x, nodes_y: step, first of a tile, side of a tile, in mm; planes `step` mm apart, the
// first of them being number `first` of its block; planar: 2D, there is no z.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void radial(global float *restrict field, global const int2 *restrict tiles,
                   global const uchar *restrict needed, global const uint *restrict starts,
                   global const uint *restrict entries, global const Axis *restrict axes_x,
                   global const Axis *restrict axes_y, global const float4 *restrict kernels,
                   global const float *restrict envelope, const uint samples, const float4 nodes_x,
                   const float4 nodes_y, const float step, const uint first, const uint planar, const uint first_tile)
{
    const uint plane = (uint)get_global_id(0);
    const uint tile_index = first_tile + (uint)get_global_id(1);
    const uint wanted = needed[tile_index * get_global_size(0) + plane];
    if (wanted == 0) return;
    const int2 tile = tiles[tile_index];
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;

    floatV sum[TILE][2][VECTORS];
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) sum[r][0][v] = sum[r][1][v] = (floatV)0.0f;
    for (uint e = starts[tile_index]; e < starts[tile_index + 1]; ++e) {
        const uint j = KERNEL_OF(entries[e]);
        const float4 k = kernels[j];
        const float turn = IS_OPPOSITE(entries[e]) ? -1.0f : 1.0f;
        const float dz = planar ? 0.0f : fma((float)(first + plane), step, k.x);
        const float scale = 1.0f / (k.w * k.w), z = dz * dz * scale;
        if (z >= 1.0f) continue;
        const float across = fma(k.y, dz, k.z);
        const float left = fma((float)(tile.x - axes_x[j].tile), nodes_x.z, nodes_x.y) - axes_x[j].offset;
        const float below = fma((float)(tile.y - axes_y[j].tile), nodes_y.z, nodes_y.y) - axes_y[j].offset;
        for (int row = 0; row < TILE; ++row) {
            if (!(wanted >> (row / ROWS) & 1u)) continue;
            const float dy = fma((float)row, nodes_y.x, below), yz = fma(dy * dy, scale, z);
            if (yz >= 1.0f) continue;
            const float phase = fma(axes_y[j].wave, dy, across);
            for (int v = 0; v < VECTORS; ++v) {
                const floatV dx = fma(lane + (float)(v * VECTOR), (floatV)nodes_x.x, (floatV)left);
                const floatV weight = weight_of(dx, yz, scale, envelope, samples);
                floatV cosine;
                const floatV sine = sincos(fma((floatV)axes_x[j].wave, dx, (floatV)phase), &cosine);
                sum[row][0][v] = fma(weight, cosine, sum[row][0][v]);
                sum[row][1][v] = fma(turn * weight, sine, sum[row][1][v]);
            }
        }
    }

    global floatV *out = (global floatV *)(field + ((size_t)plane * get_global_size(1) + get_global_id(1)) * TILE * TILE * 2);
    for (int r = 0; r < TILE; ++r)
        for (int part = 0; part < 2; ++part)
            for (int v = 0; v < VECTORS; ++v) out[(r * 2 + part) * VECTORS + v] = sum[r][part][v];
}
