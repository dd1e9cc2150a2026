// The factor of every kernel along z, with its random phase, for some layers; zero where it does not reach.

// factors: [layer][kernel] complex; kernels: (height of the block's first layer above the centre in mm, wave in rad/mm,
// phase in rad, decay in 1/mm²); decay_radius: as in tables.cl; count: kernels;
// first: number of the first layer in its block; planar: 2D, there is no z.
kernel void along_z(global float2 *restrict factors, global const float4 *restrict kernels,
                    global const float2 *restrict decay_radius, const uint count, const float layer_height,
                    const uint first, const uint planar)
{
    const uint j = (uint)get_global_id(0);
    const uint layer = (uint)get_global_id(1);
    if (j >= count) return;
    const float4 k = kernels[j];
    const float d = planar ? 0.0f : fma((float)(first + layer), layer_height, k.x);
    const float envelope = fabs(d) < decay_radius[j].y ? exp(-k.w * d * d) : 0.0f;
    const float angle = fma(k.y, d, k.z);
    factors[(size_t)layer * count + j] = envelope * (float2)(cos(angle), sin(angle));
}
