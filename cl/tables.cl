// The 1-D factors of every kernel along one pixel axis: exp(-decay·d²)·exp(i·wave·d), d the distance from
// its centre in mm; zero outside its radius (box support).

#include "tile.h"

// table: [kernel][slot][2][TILE], real parts before imaginary parts.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void tables(global float *restrict table, global const Axis *restrict axes,
                   global const float2 *restrict decay_radius, const float pitch, const int slots)
{
    const uint kernel_index = (uint)get_global_id(0);
    const Axis axis = axes[kernel_index];
    const float2 shape = decay_radius[kernel_index];
    global float *out = table + (size_t)kernel_index * slots * 2 * TILE;
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i + 0.5f;
    for (int slot = 0; slot < slots; ++slot, out += 2 * TILE)
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
