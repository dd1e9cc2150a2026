// The work layout of a laminate: tiles with TILE × TILE nodes (their pixels, or a lattice), counted from the part's own
// corner, and for each kernel (impulse) of the noise the tiles along x and y that it reaches. The host defines:
//   TILE    nodes per tile side            VECTOR  floats per vector instruction
//   ROWS    rows of nodes summed at a time BLOCK   kernels staged at a time

#ifndef AMSLICER_TILE_H
#define AMSLICER_TILE_H

#define CAT_(a, b) a##b
#define CAT(a, b) CAT_(a, b)
#define floatV CAT(float, VECTOR)
#define vloadV CAT(vload, VECTOR)
#define vstoreV CAT(vstore, VECTOR)

// One kernel of the noise along one axis: what is left of a·exp(iψ) when the other axes are held.
typedef struct {
    float offset;    // mm, from the corner of the first tile it reaches to its centre
    float wave;      // rad/mm, component of the wave vector
    int tile;        // first tile that it reaches
    uint table;      // where its factors for that tile stand: tables of TILE nodes, one for each tile that it reaches
} Axis;

// An entry of a tile's list: which kernel, and whether it is taken with the opposite sign (0x80000000) to
// agree with the tile's own direction.
#define KERNEL_OF(entry) ((entry) & 0x7FFFFFFFu)
#define IS_OPPOSITE(entry) (((entry) & 0x80000000u) != 0)

#endif
