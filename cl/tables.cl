// The 1-D factors of every kernel along x or y: exp(-decay·d²)·exp(i·wave·d), d the distance of a tile's nodes from
// its centre in mm; zero outside its radius (box support).

#include "tile.h"

// table: [kernel][tile that it reaches][2][TILE], real parts before imaginary parts; axes has one more entry than there
// are kernels, which holds the end of the last one's tables; nodes: step, first of a tile, side of a tile, in mm.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void tables(global float *restrict table, global const Axis *restrict axes,
                   global const float2 *restrict decay_radius, const float4 nodes)
{
    const uint kernel_index = (uint)get_global_id(0);
    const Axis axis = axes[kernel_index];
    const float2 shape = decay_radius[kernel_index];
    global float *out = table + (size_t)axis.table * 2 * TILE;
    const uint slots = axes[kernel_index + 1].table - axis.table;
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;
    for (uint slot = 0; slot < slots; ++slot, out += 2 * TILE) {
        const float first = fma((float)slot, nodes.z, nodes.y);
        for (int v = 0; v < TILE / VECTOR; ++v) {
            const floatV d = fma(lane + (float)(v * VECTOR), (floatV)nodes.x, (floatV)first) - axis.offset;
            const floatV inside = select((floatV)0.0f, (floatV)1.0f, fabs(d) < shape.y);
            const floatV envelope = inside * exp(-shape.x * d * d);
            floatV cosine;
            const floatV sine = sincos(axis.wave * d, &cosine);
            vstoreV(envelope * cosine, v, out);
            vstoreV(envelope * sine, v, out + TILE);
        }
    }
}
