// Draws random words for a box of cells: four for each number (for an impulse, three are its place, one its phase).
// They depend on the seed, the cell and the number alone.

#include "hash.h"

// words: [cells z][cells y][cells x][per cell]; first: index of the box's first cell; shape: cells along x, y
// and z, numbers per cell; number: the first of them.
kernel void impulses(global uint4 *words, const int4 first, const uint4 shape, const uint2 seed, const uint number)
{
    const uint index = (uint)get_global_id(0);
    const uint cell = index / shape.w;
    if (cell >= shape.x * shape.y * shape.z) return;
    const uint4 counter = (uint4)((uint)first.x + cell % shape.x, (uint)first.y + cell / shape.x % shape.y,
                                  (uint)first.z + cell / (shape.x * shape.y), number + index % shape.w);
    words[index] = philox4x32(counter, seed);
}
