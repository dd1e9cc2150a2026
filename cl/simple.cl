// G of kernels whose direction is that of the node: at each, the sum of w(|d|) exp(i(k(x)·d ± φ)) over the kernels that reach
// its tile, the sign being that of k(x) with the normal painted at the kernel: of k and -k the one is the other's conjugate.

#include "tile.h"
#include "envelope.h"

#define VECTORS (TILE / VECTOR)

// As radial.cl; kernels: (height of the block's first plane above the centre in mm, nothing, phase in rad, radius in mm); normals:
// painted at their centres; waves: k at the nodes of the tiles from first_tile on, float [plane][tile][row of nodes][x, y, z]
// [column of nodes]; slots: tiles of the field, of which the first one here is number first_slot.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void simple(global float *restrict field, global const int2 *restrict tiles,
                   global const uchar *restrict needed, global const uint *restrict starts,
                   global const uint *restrict entries, global const Axis *restrict axes_x,
                   global const Axis *restrict axes_y, global const float4 *restrict kernels,
                   global const float4 *restrict normals, global const float *restrict waves,
                   global const float *restrict envelope, const uint samples, const float4 nodes_x,
                   const float4 nodes_y, const float step, const uint first, const uint planar, const uint first_tile,
                   const uint slots, const uint first_slot)
{
    const uint plane = (uint)get_global_id(0);
    const uint tile_index = first_tile + (uint)get_global_id(1);
    const uint wanted = needed[tile_index * get_global_size(0) + plane];
    if (wanted == 0) return;
    const int2 tile = tiles[tile_index];
    const size_t here = (size_t)plane * get_global_size(1) + get_global_id(1);
    const size_t slot = (size_t)plane * slots + first_slot + get_global_id(1);
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;

    for (int row = 0; row < TILE; ++row) {
        if (!(wanted >> (row / ROWS) & 1u)) continue;
        global const floatV *k = (global const floatV *)(waves + (here * TILE + row) * 3 * TILE);
        floatV sum[2][VECTORS];
        for (int v = 0; v < VECTORS; ++v) sum[0][v] = sum[1][v] = (floatV)0.0f;
        for (uint e = starts[tile_index]; e < starts[tile_index + 1]; ++e) {
            const uint j = KERNEL_OF(entries[e]);
            const float4 shape = kernels[j], n = normals[j];
            const float dz = planar ? 0.0f : fma((float)(first + plane), step, shape.x);
            const float scale = 1.0f / (shape.w * shape.w);
            const float below = fma((float)(tile.y - axes_y[j].tile), nodes_y.z, nodes_y.y) - axes_y[j].offset;
            const float dy = fma((float)row, nodes_y.x, below), yz = fma(dy * dy, scale, dz * dz * scale);
            if (yz >= 1.0f) continue;
            const float left = fma((float)(tile.x - axes_x[j].tile), nodes_x.z, nodes_x.y) - axes_x[j].offset;
            for (int v = 0; v < VECTORS; ++v) {
                const floatV kx = k[v], ky = k[VECTORS + v], kz = k[2 * VECTORS + v];
                const floatV dx = fma(lane + (float)(v * VECTOR), (floatV)nodes_x.x, (floatV)left);
                const floatV weight = weight_of(dx, yz, scale, envelope, samples);
                const floatV along = fma(kx, (floatV)n.x, fma(ky, (floatV)n.y, kz * n.z));
                const floatV phase = select((floatV)shape.z, (floatV)-shape.z, along < 0.0f);
                floatV cosine;
                const floatV sine = sincos(fma(kx, dx, fma(ky, (floatV)dy, fma(kz, (floatV)dz, phase))), &cosine);
                sum[0][v] = fma(weight, cosine, sum[0][v]);
                sum[1][v] = fma(weight, sine, sum[1][v]);
            }
        }
        global floatV *out = (global floatV *)(field + (slot * TILE + row) * 2 * TILE);
        for (int part = 0; part < 2; ++part)
            for (int v = 0; v < VECTORS; ++v) out[part * VECTORS + v] = sum[part][v];
    }
}
