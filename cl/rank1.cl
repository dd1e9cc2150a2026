// G as a sum of rank-1 products: G[y, x] = Σ_j Z_j · Y[y, j] · X[j, x] over the kernels that reach a tile.
// No transcendental in here: four fused multiply-adds per node and kernel.

#include "tile.h"

#define VECTORS (TILE / VECTOR)
#define UNROLL __attribute__((opencl_unroll_hint(ROWS)))

// Adds the kernels staged at k = FROM … TO - 1; a kernel of opposite sign has its imaginary part turned.
#define ACCUMULATE(FROM, TO, SIGN)                                          \
    for (int k = FROM; k < TO; ++k) {                                       \
        const floatV x_re = x[k][v];                                        \
        const floatV x_im = x[k][VECTORS + v];                              \
        const float *f = (const float *)factor[k] + row;                    \
        UNROLL for (int r = 0; r < ROWS; ++r) {                             \
            re[r] = fma(x_re, (floatV)f[r], re[r]);                         \
            im[r] = fma(SIGN x_im, (floatV)f[r], im[r]);                    \
            re[r] = fma(-x_im, (floatV)f[TILE + r], re[r]);                 \
            im[r] = fma(SIGN x_re, (floatV)f[TILE + r], im[r]);             \
        }                                                                   \
    }

// field, of the tiles from first_tile on: [plane][tile][row][2][TILE], real parts before imaginary parts; tiles:
// (column, row) of each tile; needed: [tile][plane], one bit for each ROWS rows of it that anybody wants;
// entries[starts[t] .. starts[t + 1]): its kernels in order; along_z: [plane][kernel] complex, random phase included.
__attribute__((reqd_work_group_size(1, 1, 1)))
kernel void rank1(global float *restrict field, global const int2 *restrict tiles,
                  global const uchar *restrict needed, global const uint *restrict starts,
                  global const uint *restrict entries, global const float *restrict table_x,
                  global const float *restrict table_y, global const Axis *restrict axes_x,
                  global const Axis *restrict axes_y, global const float2 *restrict along_z,
                  const uint kernel_count, const uint first_tile)
{
    // Planes first: a tile's tables stay in the cache while its planes are made.
    const uint plane = (uint)get_global_id(0);
    const uint tile_index = first_tile + (uint)get_global_id(1);
    const uint wanted = needed[tile_index * get_global_size(0) + plane];
    if (wanted == 0) return;
    const int2 tile = tiles[tile_index];

    floatV sum[TILE][2][VECTORS];             // the tile's G so far
    for (int r = 0; r < TILE; ++r)
        for (int v = 0; v < VECTORS; ++v) sum[r][0][v] = sum[r][1][v] = (floatV)0.0f;

    // A block of kernels at a time, small enough for the first-level cache: those of the tile's own sign from its
    // start, those of opposite sign from its end.
    floatV factor[BLOCK][2][VECTORS];         // Z·Y of every row, real and imaginary
    global const floatV *x[BLOCK];
    const uint end = starts[tile_index + 1];
    for (uint begin = starts[tile_index]; begin < end; begin += BLOCK) {
        int same = 0, opposite = BLOCK;
        for (uint e = begin; e < min(begin + BLOCK, end); ++e) {
            const uint j = KERNEL_OF(entries[e]);
            const float2 z = along_z[(size_t)plane * kernel_count + j];
            if (z.x == 0.0f && z.y == 0.0f) continue;      // does not reach this plane
            const int k = IS_OPPOSITE(entries[e]) ? --opposite : same++;
            const size_t slot_x = (size_t)axes_x[j].table + (size_t)(tile.x - axes_x[j].tile);
            const size_t slot_y = (size_t)axes_y[j].table + (size_t)(tile.y - axes_y[j].tile);
            global const floatV *y = (global const floatV *)(table_y + slot_y * 2 * TILE);
            x[k] = (global const floatV *)(table_x + slot_x * 2 * TILE);
            for (int v = 0; v < VECTORS; ++v) {
                factor[k][0][v] = fma((floatV)z.x, y[v], -z.y * y[VECTORS + v]);
                factor[k][1][v] = fma((floatV)z.x, y[VECTORS + v], z.y * y[v]);
            }
        }
        // ROWS rows by one vector of columns: as many accumulators as the registers hold.
        for (int row = 0; row < TILE; row += ROWS) {
            if (!(wanted >> (row / ROWS) & 1u)) continue;
            for (int v = 0; v < VECTORS; ++v) {
                floatV re[ROWS], im[ROWS];
                UNROLL for (int r = 0; r < ROWS; ++r) {
                    re[r] = sum[row + r][0][v];
                    im[r] = sum[row + r][1][v];
                }
                ACCUMULATE(0, same, +)
                ACCUMULATE(opposite, BLOCK, -)
                UNROLL for (int r = 0; r < ROWS; ++r) {
                    sum[row + r][0][v] = re[r];
                    sum[row + r][1][v] = im[r];
                }
            }
        }
    }

    global floatV *out = (global floatV *)(field + ((size_t)plane * get_global_size(1) + get_global_id(1)) * TILE * TILE * 2);
    for (int r = 0; r < TILE; ++r)
        for (int part = 0; part < 2; ++part)
            for (int v = 0; v < VECTORS; ++v) out[(r * 2 + part) * VECTORS + v] = sum[r][part][v];
}
