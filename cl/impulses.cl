// Draws the impulses of a box of cells: four random words each (three for the place, one for the phase).
// A cell's impulses depend on the seed and the cell alone.

#include "hash.h"

// words: [cells z][cells y][cells x][per cell]; first: index of the box's first cell; shape: cells along x, y
// and z, impulses per cell.
kernel void impulses(global uint4 *words, const int4 first, const uint4 shape, const uint2 seed)
{
    const uint index = (uint)get_global_id(0);
    const uint cell = index / shape.w;
    if (cell >= shape.x * shape.y * shape.z) return;
    const uint4 counter = (uint4)((uint)first.x + cell % shape.x, (uint)first.y + cell / shape.x % shape.y,
                                  (uint)first.z + cell / (shape.x * shape.y), index % shape.w);
    words[index] = philox4x32(counter, seed);
}
