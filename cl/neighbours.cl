// The kernels that overlap each kernel by more than exp(least), and their overlaps (amslicer/noise/alignment.py).

#define OPPOSITE 0x80000000u

// Kernels are sorted by groups of like widths, and by the cells of each group's grid. counts: of each kernel's neighbours, in the
// first pass (filled: 0) of all that are near enough, in the second of those that overlap; starts: of their entries; entries: number of a neighbour, with OPPOSITE where its
// painted normal points against the kernel's own; overlaps: w exp(iθ). places: (x, y, z, b²), waves: (k, group), normals:
// (n, nothing), in mm and rad/mm; grids: per group the lowest corner and 1/side of its cells; shapes: cells along x, y, z, and the
// first one's number; reaches: of each group; cells: where each cell's kernels start.
kernel void neighbours(global uint *restrict counts, global const uint *restrict starts,
                       global uint *restrict entries, global float2 *restrict overlaps,
                       global const float4 *restrict places, global const float4 *restrict waves,
                       global const float4 *restrict normals, global const float4 *restrict grids,
                       global const int4 *restrict shapes, global const float *restrict reaches,
                       global const uint *restrict cells, const int groups, const uint count, const float dimensions,
                       const float least, const uint filled)
{
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const float4 place = places[i], wave = waves[i], normal = normals[i];
    const int own = (int)wave.w;
    const uint entry = filled ? starts[i] : 0;
    uint found = 0;
    for (int g = max(0, own - 1); g < min(groups, own + 2); ++g) {
        const float reach = reaches[min(g, own)];
        const int4 shape = shapes[g];
        const int3 most = shape.xyz - 1;
        const int3 low = clamp(convert_int3(floor((place.xyz - reach - grids[g].xyz) * grids[g].w)), (int3)0, most);
        const int3 high = clamp(convert_int3(floor((place.xyz + reach - grids[g].xyz) * grids[g].w)), (int3)0, most);
        for (int z = low.z; z <= high.z; ++z)
            for (int y = low.y; y <= high.y; ++y) {
                const int row = shape.w + (z * shape.y + y) * shape.x;
                const uint end = cells[row + high.x + 1];
                for (uint j = cells[row + low.x]; j < end; ++j) {
                    const float3 d = place.xyz - places[j].xyz;
                    const float squared = dot(d, d);
                    if (j == i || squared > reach * reach) continue;
                    if (!filled) {
                        ++found;
                        continue;
                    }
                    const float sign = dot(normal.xyz, normals[j].xyz) < 0.0f ? -1.0f : 1.0f;
                    const float b_i = place.w, b_j = places[j].w, total = b_i + b_j;
                    const float3 other = sign * waves[j].xyz, apart = wave.xyz - other;
                    const float alike = b_i == b_j ? 0.0f : log(4.0f * b_i * b_j / (total * total));
                    const float exponent = 0.25f * dimensions * alike - M_PI_F * b_i * b_j * squared / total
                                           - dot(apart, apart) / (4.0f * M_PI_F * total);
                    if (exponent <= least) continue;
                    float cosine;
                    const float sine = sincos((b_i * dot(other, d) + b_j * dot(wave.xyz, d)) / total, &cosine);
                    entries[entry + found] = j | (sign < 0.0f ? OPPOSITE : 0u);
                    overlaps[entry + found] = exp(exponent) * (float2)(cosine, sine);
                    ++found;
                }
            }
    }
    counts[i] = found;
}
