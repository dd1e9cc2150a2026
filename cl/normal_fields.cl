// Random fields that are exactly N(0, 1) at every place: Σ γ g / √(Σ g²), g = exp(-π d²), over hashed points. One
// work-item per place; lengths in cells.

#define REACH 2      // cells on each side whose points count; noise/turn.py leaves so many around every place
#define CUT 4.0f     // squared distance beyond which g < 4e-6 counts as 0

// places: within their cells, 0…1; cells: of each place, in the box; points, weights: [cells z][cells y][cells x][per
// cell]; box: cells along x, y, z, points per cell.
kernel void normal_fields(global float4 *restrict fields, global const float4 *restrict places,
                          global const int4 *restrict cells, global const float4 *restrict points,
                          global const float4 *restrict weights, const uint4 box, const uint count,
                          const uint planar)
{
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const float4 place = places[i];
    const int4 cell = cells[i];
    const int up = planar ? 0 : REACH;
    float4 sum = (float4)(0.0f);
    float power = 0.0f;
    for (int z = -up; z <= up; ++z)
        for (int y = -REACH; y <= REACH; ++y)
            for (int x = -REACH; x <= REACH; ++x) {
                const uint3 c = (uint3)((uint)(cell.x + x), (uint)(cell.y + y), (uint)(cell.z + z));
                const size_t first = (((size_t)c.z * box.y + c.y) * box.x + c.x) * box.w;
                for (uint m = 0; m < box.w; ++m) {
                    const float4 d = points[first + m] + (float4)(x, y, z, 0) - place;
                    const float squared = fma(d.x, d.x, fma(d.y, d.y, d.z * d.z));
                    if (squared >= CUT) continue;
                    const float g = exp(-3.14159265f * squared);
                    sum = fma((float4)(g), weights[first + m], sum);
                    power = fma(g, g, power);
                }
            }
    fields[i] = sum / sqrt(power);
}
