// G as cl/per_pixel.cl gives it, a vector of pixels at a time: what explicit vectors alone are worth. Only measured.

#include "tile.h"

// Arguments as in per_pixel.cl.
kernel void per_pixel_vector(global float *restrict field, global const int2 *restrict tiles,
                             global const uint *restrict starts, global const uint *restrict entries,
                             global const float2 *restrict decay_radius,
                             global const Axis *restrict axes_x, global const Axis *restrict axes_y,
                             global const float2 *restrict along_z, const uint kernel_count,
                             const float pitch_x, const float pitch_y)
{
    const int column = (int)get_global_id(0) * VECTOR;
    const int row = (int)get_global_id(1) % TILE;
    const uint tile_index = (uint)get_global_id(1) / TILE;
    const uint tile_count = (uint)get_global_size(1) / TILE;
    const uint layer = (uint)get_global_id(2);
    const int2 pixel = tiles[tile_index] * TILE + (int2)(column, row);
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i + 0.5f;

    floatV re = (floatV)0.0f, im = (floatV)0.0f;
    for (uint e = starts[tile_index]; e < starts[tile_index + 1]; ++e) {
        const uint j = KERNEL_OF(entries[e]);
        const float2 z = along_z[(size_t)layer * kernel_count + j];
        const float2 shape = decay_radius[j];
        const floatV dx = ((float)(pixel.x - axes_x[j].tile * TILE) + lane) * pitch_x - axes_x[j].offset;
        const float dy = ((float)(pixel.y - axes_y[j].tile * TILE) + 0.5f) * pitch_y - axes_y[j].offset;
        if (fabs(dy) >= shape.y) continue;
        const floatV inside = select((floatV)0.0f, (floatV)1.0f, fabs(dx) < shape.y);
        const floatV envelope = inside * exp(-shape.x * (dx * dx + dy * dy));
        floatV cosine;
        const floatV sine = envelope * sincos(axes_x[j].wave * dx + axes_y[j].wave * dy, &cosine);
        cosine *= envelope;
        re += z.x * cosine - z.y * sine;
        im += (IS_OPPOSITE(entries[e]) ? -1.0f : 1.0f) * (z.x * sine + z.y * cosine);
    }
    global float *out = field + (((size_t)layer * tile_count + tile_index) * TILE + row) * 2 * TILE + column;
    vstoreV(re, 0, out);
    vstoreV(im, 0, out + TILE);
}
