// G as it is defined: at every pixel, the sum of a_j(x) exp(iψ_j) over the kernels that reach its tile, with
// one exponential, sine and cosine per kernel. The readable form, which tests and figures compare rank1.cl with.

#include "tile.h"

// Arguments as in rank1.cl; decay_radius: 1/mm² and mm of each kernel.
kernel void per_pixel(global float *restrict field, global const int2 *restrict tiles,
                      global const uint *restrict starts, global const uint *restrict entries,
                      global const float2 *restrict decay_radius,
                      global const Axis *restrict axes_x, global const Axis *restrict axes_y,
                      global const float2 *restrict along_z, const uint kernel_count,
                      const float pitch_x, const float pitch_y)
{
    const int column = (int)get_global_id(0);
    const int row = (int)get_global_id(1) % TILE;
    const uint tile_index = (uint)get_global_id(1) / TILE;
    const uint tile_count = (uint)get_global_size(1) / TILE;
    const uint layer = (uint)get_global_id(2);
    const int2 pixel = tiles[tile_index] * TILE + (int2)(column, row);

    float2 sum = (float2)(0.0f, 0.0f);
    for (uint e = starts[tile_index]; e < starts[tile_index + 1]; ++e) {
        const uint j = KERNEL_OF(entries[e]);
        const float2 z = along_z[(size_t)layer * kernel_count + j];
        const float2 shape = decay_radius[j];
        const float dx = ((float)(pixel.x - axes_x[j].tile * TILE) + 0.5f) * pitch_x - axes_x[j].offset;
        const float dy = ((float)(pixel.y - axes_y[j].tile * TILE) + 0.5f) * pitch_y - axes_y[j].offset;
        if (fabs(dx) >= shape.y || fabs(dy) >= shape.y) continue;
        const float envelope = exp(-shape.x * (dx * dx + dy * dy));
        const float angle = axes_x[j].wave * dx + axes_y[j].wave * dy;
        const float2 wave = envelope * (float2)(cos(angle), sin(angle));
        sum.x += z.x * wave.x - z.y * wave.y;
        sum.y += (IS_OPPOSITE(entries[e]) ? -1.0f : 1.0f) * (z.x * wave.y + z.y * wave.x);
    }
    global float *out = field + (((size_t)layer * tile_count + tile_index) * TILE + row) * 2 * TILE + column;
    out[0] = sum.x;
    out[TILE] = sum.y;
}
