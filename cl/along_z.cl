// The factor of every kernel along z, with its random phase, for some planes of nodes; zero where it does not reach.

#include "tile.h"

// factors: [plane][kernel] complex; kernels: (height of the block's first plane above the centre in mm, wave in rad/mm,
// phase in rad, decay in 1/mm²); decay_radius: as in tables.cl; count: kernels; planes: how many, `step` mm apart, the
// first of them being number `first` of its block; planar: 2D, there is no z.
kernel void along_z(global float2 *restrict factors, global const float4 *restrict kernels,
                    global const float2 *restrict decay_radius, const uint count, const uint planes,
                    const float step, const uint first, const uint planar)
{
    const uint j = (uint)get_global_id(0);
    if (j >= count) return;
    const float4 k = kernels[j];
    const float radius = decay_radius[j].y;
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;
    for (uint begin = 0; begin < planes; begin += VECTOR) {
        const floatV plane = lane + (float)(first + begin);
        const floatV d = planar ? (floatV)0.0f : fma(plane, (floatV)step, (floatV)k.x);
        const floatV inside = select((floatV)0.0f, (floatV)1.0f, fabs(d) < radius);
        const floatV envelope = inside * exp(-k.w * d * d);
        floatV cosine;
        const floatV sine = envelope * sincos(fma((floatV)k.y, d, (floatV)k.z), &cosine);
        cosine *= envelope;
        for (uint i = 0; i < min((uint)VECTOR, planes - begin); ++i)
            factors[(size_t)(begin + i) * count + j] = (float2)(((float *)&cosine)[i], ((const float *)&sine)[i]);
    }
}
