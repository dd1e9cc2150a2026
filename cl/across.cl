// Rows of texels at the pixels' columns: a painted field between two texels of a row, linear.

// wide: [texel rows][columns]; texels: [texel rows][texels]; below, above, share: per column. A work-item for each row.
kernel void across(global float *restrict wide, global const float *restrict texels, global const int *restrict below,
                   global const int *restrict above, global const float *restrict share, const uint texel_columns,
                   const uint columns, const uint texel_rows)
{
    const uint row = (uint)get_global_id(0);
    if (row >= texel_rows) return;
    global const float *from = texels + (size_t)row * texel_columns;
    global float *to = wide + (size_t)row * columns;
    for (uint column = 0; column < columns; ++column) {
        const float low = from[below[column]];
        to[column] = fma(share[column], from[above[column]] - low, low);
    }
}
