// Sets the bits of the runs of solid pixels of each row; everything else stays 0.

// solid: [rows][bytes], a pixel per bit, the highest first, all layers' rows one after another; run n of row r:
// starts[r] <= n < starts[r + 1], columns runs[n].x to runs[n].y - 1.
kernel void fill(global uchar *restrict solid, global const uint *restrict starts,
                 global const int2 *restrict runs, const uint row_bytes, const uint rows,
                 const uint padded_rows, const uint all_rows)
{
    const uint row = (uint)get_global_id(0);
    if (row >= all_rows) return;
    global uchar *line = solid + ((size_t)(row / rows) * padded_rows + row % rows) * row_bytes;
    for (uint n = starts[row]; n < starts[row + 1]; ++n) {
        if (runs[n].x >= runs[n].y) continue;
        const int first = runs[n].x >> 3, last = (runs[n].y - 1) >> 3;
        const uchar head = (uchar)(0xFF >> (runs[n].x & 7)), tail = (uchar)(0xFF << (7 - ((runs[n].y - 1) & 7)));
        if (first == last) {
            line[first] |= head & tail;
            continue;
        }
        line[first] |= head;
        for (int byte = first + 1; byte < last; ++byte) line[byte] = 0xFF;
        line[last] |= tail;
    }
}
