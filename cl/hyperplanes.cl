// Cells between random planes (noise/hyperplanes.py): at each node, minus the distance to the nearest wall, or minus
// the number of the cell that it is in.

#include "tile.h"
#include "hash.h"
#include "hash_vector.h"

#define VECTORS (TILE / VECTOR)
#define intV CAT(int, VECTOR)
#define convert_floatV CAT(convert_float, VECTOR)
#define FRACTION 40  // bits of a place in spacings that are behind the point: amslicer/planeevaluator.py
#define TO_SHARE (1.0f / 16777216.0f)  // of 24 bits, which a float holds
#define FIRST_PLACE 0.3f               // of a plane, in spacings
#define PLACES 0.4f

// A stack of parallel planes. The place of a tile's first node, in spacings, is fixed-point: far away, float32 would be
// too coarse.
typedef struct {
    long across, down, at;  // from a tile to the next along x and y; of the tile (0, 0) in the block's first plane
    float x, y, z;          // unit normal
    float plane;            // of a slice's waves: where the plane below the slice is, 0…1 of the places it may have
} Stack;

typedef struct {
    Stack stack;         // between its planes are the slices
    int first;           // slice in the table
    uint table;          // where that one stands
    uint name, padding;  // third word of the counters
} Family;

// A stack as seen from a tile; all but the first two in mm along its direction, from the tile's first node.
typedef struct {
    int index;       // the place of that node in spacings, rounded down
    float fraction;  // and the rest of it
    float start, column, row;  // first node of the plane of nodes; from a column or row to the next
    float low, high;           // of all nodes
} Seen;

Seen seen(global const Stack *stack, const int2 tile, const float4 node)
{
    const long place = stack->at + tile.x * stack->across + tile.y * stack->down;
    const float start = stack->z * node.z, column = stack->x * node.x, row = stack->y * node.y;
    const float right = column * (TILE - 1), up = row * (TILE - 1);
    const float fraction = (float)(uint)(place >> (FRACTION - 24) & 0xFFFFFF) * TO_SHARE;
    return (Seen){(int)(place >> FRACTION), fraction, start, column, row,
                  start + min(right, 0.0f) + min(up, 0.0f), start + max(right, 0.0f) + max(up, 0.0f)};
}

// Where plane i is, in mm.
float plane_at(const Seen s, const int i, const float place, const float spacing)
{
    return ((float)(i - s.index) + FIRST_PLACE + PLACES * place - s.fraction) * spacing;
}

// A plane that lies before all nodes, less than two spacings away.
int plane_before(const Seen s, const float spacing)
{
    return s.index + (int)floor(s.low / spacing + s.fraction) - 1;
}

float share_of(const uint word) { return (float)(word >> 8) * TO_SHARE; }

// field, tiles, needed and first_tile as in rank1.cl, the values being the real part; families: `directions` for each
// of `levels`; slices: the waves of all; spacing: of all stacks, mm; steps: from node to node and plane to plane, mm;
// numbers: fourth words of the counters of waves and of cells; probability: that a cell is divided further; numbered:
// the value is minus the cell's number; first: number in the block of the first plane.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void hyperplanes(global float *restrict field, global const int2 *restrict tiles,
                        global const uchar *restrict needed, global const Family *restrict families,
                        global const Stack *restrict slices, const uint directions, const uint levels,
                        const float spacing, const float4 steps, const uint2 seed, const uint2 numbers,
                        const float probability, const uint numbered, const uint first, const uint first_tile)
{
    const uint plane = (uint)get_global_id(0);
    const uint tile_index = first_tile + (uint)get_global_id(1);
    const uint wanted = needed[tile_index * get_global_size(0) + plane];
    if (wanted == 0) return;
    const int2 tile = tiles[tile_index];
    const float4 node = (float4)(steps.xy, (float)(first + plane) * steps.z, 0.0f);
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;

    floatV near[TILE][VECTORS], inside[TILE][VECTORS];    // distance to the nearest plane; of the family
    uintV code[TILE][2][VECTORS], own[TILE][2][VECTORS];  // of the cell; the family's part of it
    intV divided[TILE][VECTORS];                          // whether the planes of this level count
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) {
            near[r][v] = (floatV)INFINITY;
            code[r][0][v] = code[r][1][v] = (uintV)0u;
            divided[r][v] = (intV)-1;
        }
    uint rows = 0;  // a bit for each that has nodes in cells of this level
    for (int r = 0; r < TILE; ++r) rows |= (wanted >> (r / ROWS) & 1u) << r;
    for (uint level = 0; level < levels && rows; ++level) {
        const int coded = numbered || level + 1 < levels;  // whether the cells' numbers matter
        for (uint f = level * directions; f < (level + 1) * directions; ++f) {
            global const Family *family = families + f;
            for (int r = 0; r < TILE; ++r)
                for (int v = 0; v < VECTORS; ++v) inside[r][v] = (floatV)-INFINITY;
            const Seen across = seen(&family->stack, tile, node);
            global const Stack *waves = slices + family->table - family->first;
            int s = plane_before(across, spacing);
            float bottom = plane_at(across, s, waves[s].plane, spacing), top;
            for (; bottom <= across.high; ++s, bottom = top) {
                top = plane_at(across, s + 1, waves[s + 1].plane, spacing);
                if (top < across.low) continue;
                const Seen along = seen(waves + s, tile, node);
                int w = plane_before(along, spacing);
                uint4 words = philox4x32((uint4)((uint)w, (uint)s, family->name, numbers.x), seed), next;
                float left = plane_at(along, w, share_of(words.x), spacing), right;
                for (; left <= along.high; ++w, left = right, words = next) {
                    next = philox4x32((uint4)((uint)w + 1u, (uint)s, family->name, numbers.x), seed);
                    right = plane_at(along, w + 1, share_of(next.x), spacing);
                    if (right < along.low) continue;
                    // A convex piece: the least of the distances to its four sides is positive inside it only, so
                    // the largest of all pieces is that of the node's own.
                    for (int r = 0; r < TILE; ++r) {
                        if (!(rows >> r & 1u)) continue;
                        const float p0 = fma((float)r, across.row, across.start);
                        const float q0 = fma((float)r, along.row, along.start);
                        for (int v = 0; v < VECTORS; ++v) {
                            const floatV column = lane + (float)(v * VECTOR);
                            const floatV p = fma(column, (floatV)across.column, (floatV)p0);
                            const floatV q = fma(column, (floatV)along.column, (floatV)q0);
                            const floatV d = min(min(p - bottom, top - p), min(q - left, right - q));
                            if (coded) {
                                const intV better = d > inside[r][v];
                                own[r][0][v] = select(own[r][0][v], (uintV)words.y, better);
                                own[r][1][v] = select(own[r][1][v], (uintV)words.z, better);
                            }
                            inside[r][v] = max(inside[r][v], d);
                        }
                    }
                }
            }
            for (int r = 0; r < TILE; ++r) {
                if (!(rows >> r & 1u)) continue;
                for (int v = 0; v < VECTORS; ++v) {
                    near[r][v] = select(near[r][v], min(near[r][v], max(inside[r][v], 0.0f)), divided[r][v]);
                    if (!coded) continue;
                    code[r][0][v] ^= own[r][0][v];
                    code[r][1][v] ^= own[r][1][v];
                }
            }
        }
        if (!coded) break;
        for (int r = 0; r < TILE; ++r) {
            if (!(rows >> r & 1u)) continue;
            int goes_on = 0;
            for (int v = 0; v < VECTORS; ++v) {
                uintV words[4] = {code[r][0][v], code[r][1][v], (uintV)level, (uintV)numbers.y};
                philox4x32V(words, seed);
                const floatV number = convert_floatV(words[0] >> 8) * TO_SHARE;
                if (numbered) near[r][v] = select(near[r][v], number, divided[r][v]);
                divided[r][v] &= number < probability;
                goes_on |= any(divided[r][v]);
            }
            if (!goes_on) rows &= ~(1u << r);
        }
    }

    const size_t place = (size_t)plane * get_global_size(1) + get_global_id(1);
    global floatV *out = (global floatV *)(field + place * TILE * TILE * 2);
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) {
            out[r * 2 * VECTORS + v] = -near[r][v];
            out[(r * 2 + 1) * VECTORS + v] = (floatV)0.0f;
        }
}
