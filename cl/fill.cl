// Fills the runs of solid pixels of each row; everything else stays 0.

// solid: [rows][padded columns], all layers' rows one after another; run n of row r: starts[r] <= n <
// starts[r + 1], columns runs[n].x to runs[n].y - 1.
kernel void fill(global uchar *restrict solid, global const uint *restrict starts,
                 global const int2 *restrict runs, const uint padded_columns, const uint rows,
                 const uint padded_rows, const uint all_rows)
{
    const uint row = (uint)get_global_id(0);
    if (row >= all_rows) return;
    const size_t plane = (size_t)(row / rows) * padded_rows + row % rows;
    for (uint n = starts[row]; n < starts[row + 1]; ++n)
        for (int column = runs[n].x; column < runs[n].y; ++column) solid[plane * padded_columns + column] = 1;
}
