// G of wave noise: at each node, Σ w T(x·ω) / √(Σ w²) over the slices of waves that reach its tile, T read from a table with
// linear interpolation.

#include "tile.h"

#define VECTORS (TILE / VECTOR)
#define intV CAT(int, VECTOR)
#define to_intV CAT(convert_int, VECTOR)
#define to_floatV CAT(convert_float, VECTOR)

// A slice of a wave: steps from node to node along x, y, z of its table's place, in samples (w: number of its table), and of the
// place across the slice, in units of the width over which slices are blended (w: its mean power); its direction (w: unused).
typedef struct {
    float4 table;
    float4 across;
    float4 direction;
} Wave;

// An entry of a tile's list. sample, part: where in the table the tile's first node is on the block's first plane; low, high:
// how far that node is above the slice's beginning and below its end, plus ½; weight: of a painted direction that is the same
// everywhere; blended: whether the tile meets another slice.
typedef struct {
    uint wave;
    int sample;
    float part;
    float low;
    float high;
    float weight;
    uint blended;
    uint opposite;
} Entry;

// One of two slices that are blended: u/√(u² + (1-u)²), with u going smoothly from 0 to 1.
floatV amplitude(const floatV place)
{
    const floatV t = clamp(place, (floatV)0.0f, (floatV)1.0f);
    const floatV u = t * t * (3.0f - 2.0f * t), v = 1.0f - u;
    return u / sqrt(fma(u, u, v * v));
}

// Values at an index and a part of the way to the next one.
floatV between(global const float *values, const intV index, const floatV part)
{
    floatV low, high;
    for (int i = 0; i < VECTOR; ++i) {
        ((float *)&low)[i] = values[((const int *)&index)[i]];
        ((float *)&high)[i] = values[((const int *)&index)[i] + 1];
    }
    return fma(part, high - low, low);
}

float2 mix_of(const float2 a, const float2 b, const float share) { return fma((float2)share, b - a, a); }

// The host defines PAINTED: direction or isotropy change, and each node has its own; LEVELS: tables, of painted periods,
// more than one; SAMPLES: of a table, a power of two; COSINES, ISOTROPIES: of the table of weights.
// field, tiles, needed, starts and first_tile as in rank1.cl; tables: [LEVELS][SAMPLES + 1] complex; weights: [ISOTROPIES]
// [COSINES + 1]; paint: [plane][tile][row][5][TILE], normal (3), which isotropy, which table; painted_planes: of it, 1 where
// it is the same on all; first: number of the first plane in its block; slots, offset: tiles of a plane of field, and where
// first_tile is among them.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void waves(global float *restrict field, global const uchar *restrict needed, global const uint *restrict starts,
                  global const Entry *restrict entries, global const Wave *restrict waves_of,
                  global const float2 *restrict tables, global const float *restrict weights,
                  global const float *restrict paint, const uint painted_planes, const uint first, const uint first_tile,
                  const uint slots, const uint offset)
{
    const uint plane = (uint)get_global_id(0);
    const uint tile_index = first_tile + (uint)get_global_id(1);
    const uint wanted = needed[tile_index * get_global_size(0) + plane];
    if (wanted == 0) return;
    floatV lane;
    for (int i = 0; i < VECTOR; ++i) ((float *)&lane)[i] = (float)i;
    const float up = (float)(first + plane);
#if PAINTED || LEVELS > 1
    global const floatV *here = (global const floatV *)(
        paint + ((size_t)(painted_planes > 1 ? plane : 0) * get_global_size(1) + get_global_id(1)) * TILE * 5 * TILE);
#endif

    floatV sum[TILE][2][VECTORS], power[TILE][VECTORS];
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) sum[r][0][v] = sum[r][1][v] = power[r][v] = (floatV)0.0f;
    for (uint e = starts[tile_index]; e < starts[tile_index + 1]; ++e) {
        const Entry entry = entries[e];
        const Wave wave = waves_of[entry.wave];
        global const float2 *table = tables + (size_t)wave.table.w * (SAMPLES + 1);
        const float sign = entry.opposite ? -1.0f : 1.0f;
        for (int row = 0; row < TILE; ++row) {
            if (!(wanted >> (row / ROWS) & 1u)) continue;
            const float start = fma(wave.table.z, up, fma(wave.table.y, (float)row, entry.part));
            const float across = fma(wave.across.z, up, wave.across.y * (float)row);
            for (int v = 0; v < VECTORS; ++v) {
                const floatV column = lane + (float)(v * VECTOR);
                floatV weight = (floatV)entry.weight, turn = (floatV)sign;
#if PAINTED
                global const floatV *node = here + row * 5 * VECTORS + v;
                const floatV cosine = fma((floatV)wave.direction.z, node[2 * VECTORS], fma((floatV)wave.direction.y,
                                          node[VECTORS], wave.direction.x * node[0]));
                turn = select((floatV)1.0f, (floatV)-1.0f, cosine < 0.0f);
                const floatV at = fmin(fabs(cosine), (floatV)1.0f) * (float)COSINES;
                const intV index = min(to_intV(at), (intV)(COSINES - 1));
                const floatV part = at - to_floatV(index);
#if ISOTROPIES > 1
                const floatV isotropy = node[3 * VECTORS];
                const intV below = min(to_intV(isotropy), (intV)(ISOTROPIES - 2));
                const intV place = below * (COSINES + 1) + index;
                const floatV one = between(weights, place, part);
                const floatV other = between(weights, place + (COSINES + 1), part);
                weight = fma(isotropy - to_floatV(below), other - one, one);
#else
                weight = between(weights, index, part);
#endif
#endif
                if (entry.blended) {
                    const floatV along = fma(column, (floatV)wave.across.x, (floatV)across);
                    weight *= amplitude(entry.low + along) * amplitude(entry.high - along);
                }
                const floatV place_in = fma(column, (floatV)wave.table.x, (floatV)start);
                const floatV whole = floor(place_in), share = place_in - whole;
                const intV sample = (to_intV(whole) + entry.sample) & (SAMPLES - 1);
                floatV re, im, re_next, im_next;
#if LEVELS > 1
                const floatV level = here[row * 5 * VECTORS + 4 * VECTORS + v];
                const intV lower = min(to_intV(level), (intV)(LEVELS - 2));
                const floatV mix = level - to_floatV(lower);
#endif
                for (int i = 0; i < VECTOR; ++i) {
                    const int s = ((const int *)&sample)[i];
#if LEVELS > 1
                    const float m = ((const float *)&mix)[i];
                    global const float2 *low = table + (size_t)((const int *)&lower)[i] * (SAMPLES + 1) + s;
                    const float2 a = mix_of(low[0], low[SAMPLES + 1], m), b = mix_of(low[1], low[SAMPLES + 2], m);
#else
                    const float2 a = table[s], b = table[s + 1];
#endif
                    ((float *)&re)[i] = a.x;
                    ((float *)&im)[i] = a.y;
                    ((float *)&re_next)[i] = b.x;
                    ((float *)&im_next)[i] = b.y;
                }
                sum[row][0][v] = fma(weight, fma(share, re_next - re, re), sum[row][0][v]);
                sum[row][1][v] = fma(weight * turn, fma(share, im_next - im, im), sum[row][1][v]);
                power[row][v] = fma(weight * wave.across.w, weight, power[row][v]);
            }
        }
    }

    global floatV *out = (global floatV *)(field + ((size_t)plane * slots + offset + get_global_id(1)) * TILE * TILE * 2);
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) {
            const floatV scale = 1.0f / sqrt(fmax(power[r][v], (floatV)FLT_MIN));
            out[(r * 2) * VECTORS + v] = sum[r][0][v] * scale;
            out[(r * 2 + 1) * VECTORS + v] = sum[r][1][v] * scale;
        }
}
