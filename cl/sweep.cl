// One sweep of phase alignment: each z becomes the direction of itself and the overlaps of its neighbours.

#define OPPOSITE 0x80000000u

// after, before: exp(iφ) of each kernel; starts, counts, entries, overlaps: as neighbours.cl leaves them; known: which kernels keep
// their phase where only neighbours count (alone: 1), for the others before is what they keep where nothing overlaps.
kernel void sweep(global float2 *restrict after, global const float2 *restrict before,
                  global const uint *restrict starts, global const uint *restrict counts,
                  global const uint *restrict entries,
                  global const float2 *restrict overlaps, global const uchar *restrict known, const uint alone,
                  const uint count)
{
    const uint i = (uint)get_global_id(0);
    if (i >= count) return;
    const float2 own = before[i];
    if (alone && known[i]) {
        after[i] = own;
        return;
    }
    float2 sum = alone ? (float2)(0.0f, 0.0f) : own;
    for (uint e = starts[i]; e < starts[i] + counts[i]; ++e) {
        const uint j = entries[e] & ~OPPOSITE;
        if (alone && !known[j]) continue;
        const float2 z = before[j], w = overlaps[e];
        const float im = entries[e] & OPPOSITE ? -z.y : z.y;
        sum.x += w.x * z.x - w.y * im;
        sum.y += w.x * im + w.y * z.x;
    }
    const float size = sqrt(sum.x * sum.x + sum.y * sum.y);
    after[i] = size > 0.0f ? sum / size : own;
}
