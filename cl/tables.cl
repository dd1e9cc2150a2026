// The 1-D factors of every kernel along one pixel axis: exp(-decay·d²)·exp(i·wave·d), d the distance from
// its centre in mm; zero outside its radius (box support).

#include "tile.h"

// table: [kernel][tile that it reaches][2][TILE], real parts before imaginary parts; axes has one more entry than there
// are kernels, which holds the end of the last one's tables.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void tables(global float *restrict table, global const Axis *restrict axes,
                   global const float2 *restrict decay_radius, const float pitch)
{
    const uint kernel_index = (uint)get_global_id(0);
    const Axis axis = axes[kernel_index];
    const float2 shape = decay_radius[kernel_index];
    global float *out = table + (size_t)axis.table * 2 * TILE;
    const uint slots = axes[kernel_index + 1].table - axis.table;
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i + 0.5f;
    for (uint slot = 0; slot < slots; ++slot, out += 2 * TILE)
        for (int v = 0; v < TILE / VECTOR; ++v) {
            const floatV d = (lane + (float)(slot * TILE + v * VECTOR)) * pitch - axis.offset;
            const floatV inside = select((floatV)0.0f, (floatV)1.0f, fabs(d) < shape.y);
            const floatV envelope = inside * exp(-shape.x * d * d);
            floatV cosine;
            const floatV sine = sincos(axis.wave * d, &cosine);
            vstoreV(envelope * cosine, v, out);
            vstoreV(envelope * sine, v, out + TILE);
        }
}
