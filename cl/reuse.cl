// The materials of a planar pattern, which are the same in every layer, where each layer is solid.

// deposits: [layer][material][rows][bytes]; labels: [material][rows][bytes], as if all pixels were solid; solid:
// [layer][rows][bytes]; a bit per pixel. A work-item for each row of each layer.
kernel void reuse(global uchar *restrict deposits, global const uchar *restrict labels,
                  global const uchar *restrict solid, const uint materials, const uint rows, const uint bytes,
                  const uint layers)
{
    const uint line = (uint)get_global_id(0);
    if (line >= layers * rows) return;
    const uint layer = line / rows, row = line % rows;
    global const uchar *here = solid + (size_t)line * bytes;
    for (uint m = 0; m < materials; ++m) {
        global const uchar *label = labels + ((size_t)m * rows + row) * bytes;
        global uchar *out = deposits + (((size_t)layer * materials + m) * rows + row) * bytes;
        for (uint i = 0; i < bytes; ++i) out[i] = label[i] & here[i];
    }
}
