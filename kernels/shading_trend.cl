/* The trend of shading (beyond the paper): how encoded colour changed on static surfaces from rendered frame t-1 to t, over wide
   areas, and that of the interval before, carried on to t + alpha. What lights do slowly goes on; what flickers or turns does
   not: the shading correction network tells them apart.
   A cell has 8x8 pixels of the rendered image; a few of them stand for all. */

#include "frame.h"
#include "mu_law.h"

#define REACH_SHARE 120  /* rows of the image per cell of reach: the neighbourhood's sigma is about a 34th of its height */
#define CELL 8
#define SAMPLE_STRIDE 4        /* px, from the second pixel of a cell on */
#define SAME_SURFACE 0.03f     /* relative depth within which t-1 shows the same surface */
#define MOST_CHANGE 1048576.0f /* factor of one pixel's colour: products over a cell stay within floats */
#define CHANGES 4              /* planes: of R, G, B, and the share of samples that show what is static in both frames */
#define THIRD 0.33333334f
#define LEAST_SHARE 0.05f      /* of a neighbourhood: fewer samples say less */

/* Rendered frames t and t-1. */
typedef struct {
    __global const half *color;
    __global const float *depth;
    __global const uchar *dynamic_mask;
    __global const half *color_prev;
    __global const float *depth_prev;
} Frames;

/* By which factor the colour of a pixel has changed since t-1, 1 where it is not known; returns whether it is. */
inline bool change_at(const int src_x, const int src_y, const Frame *frame, const Frames f, float3 *change) {
    const int source_width = frame->source_width, source_height = frame->source_height;
    const float4 law = frame->color_law;
    *change = (float3)(1.0f);
    if (!inside(src_x, src_y, source_width, source_height)) return false;
    const int src = src_y * source_width + src_x;
    const float z = f.depth[src];
    if (f.dynamic_mask[src] || INVALID_DEPTH(z)) return false;
    const float3 before = reproject(pixel_centre(src_x, src_y), z, frame->to_previous);
    const float x = before.x - 0.5f, y = before.y - 0.5f;
    if (!(before.z > 0.0f && x >= 0.0f && y >= 0.0f && x < (float)(source_width - 1) && y < (float)(source_height - 1)))
        return false;
    const int first = (int)y * source_width + (int)x;
    float3 sum = (float3)(0.0f);
    for (int tap = 0; tap < 4; ++tap) {
        const int at = first + (tap & 1) + (tap >> 1) * source_width;
        if (!is_same_surface(f.depth_prev[at], before.z, SAME_SURFACE * before.z)) return false;
        sum += bilinear_weight(tap, x - (float)(int)x, y - (float)(int)y) * load_color(f.color_prev, at);
    }
    const float3 now = load_color(f.color, src);
    change->x = divide(LIFTED(float, now.x, law), LIFTED(float, sum.x, law));
    change->y = divide(LIFTED(float, now.y, law), LIFTED(float, sum.y, law));
    change->z = divide(LIFTED(float, now.z, law), LIFTED(float, sum.z, law));
    *change = clamp(*change, 1.0f / MOST_CHANGE, MOST_CHANGE);
    return true;
}

/* Planes of the summed change of encoded colour of a cell's samples, and of the share that is known, over the number of samples. */
WIDE __kernel void measure_changes(const Frame frame, __global const half *color, __global const float *depth,
                                   __global const uchar *dynamic_mask, __global const half *color_prev,
                                   __global const float *depth_prev, __global float *changes) {
    const Frames frames = {color, depth, dynamic_mask, color_prev, depth_prev};
    const int cells_width = frame.cells_width, cells_height = frame.cells_height;
    const float4 law = frame.color_law;
    const int first_x = get_global_id(0) * LANES, cell_y = get_global_id(1);
    if (first_x >= cells_width || cell_y >= cells_height) return;
    const int count = min(LANES, cells_width - first_x), plane = cells_width * cells_height;
    float factor[3][LANES], known[LANES];
    for (int k = 0; k < LANES; ++k) {
        float3 product = (float3)(1.0f), change;
        known[k] = 0.0f;
        for (int y = 1; y < CELL && k < count; y += SAMPLE_STRIDE)
            for (int x = 1; x < CELL; x += SAMPLE_STRIDE) {
                if (change_at((first_x + k) * CELL + x, cell_y * CELL + y, &frame, frames, &change)) known[k] += 1.0f;
                product *= change;
            }
        factor[0][k] = product.x;
        factor[1][k] = product.y;
        factor[2][k] = product.z;
    }
    const float share = (float)(SAMPLE_STRIDE * SAMPLE_STRIDE) / (float)(CELL * CELL);
    __global float *out = changes + cell_y * cells_width + first_x;
    for (int c = 0; c < 3; ++c)
        store_some_floats(log_of(load_floats(0, factor[c])) * (law.y * share), count, out + c * plane);
    store_some_floats(load_floats(0, known) * share, count, out + 3 * plane);
}

/* Every plane blurred along rows: a cell counts the less the farther away it is, none farther than the reach; beyond the image
   there is nothing. */
__kernel void blur_rows(const Frame frame, __global const float *changes, __global float *blurred) {
    const int reach = max(1, frame.source_height / REACH_SHARE);
    const int cells_width = frame.cells_width, cells_height = frame.cells_height;
    const int cell_x = get_global_id(0), cell_y = get_global_id(1);
    if (cell_x >= cells_width || cell_y >= cells_height) return;
    const int plane = cells_width * cells_height, row = cell_y * cells_width;
    for (int c = 0; c < CHANGES; ++c) {
        float sum = 0.0f;
        for (int x = max(cell_x - reach, 0); x <= min(cell_x + reach, cells_width - 1); ++x)
            sum += (float)(reach + 1 - abs(x - cell_x)) * changes[c * plane + row + x];
        blurred[c * plane + row + cell_x] = sum;
    }
}

/* The same along columns, and the mean of what is known. */
__kernel void find_trend(const Frame frame, __global const float *blurred, __global float *trend) {
    const int reach = max(1, frame.source_height / REACH_SHARE);
    const int cells_width = frame.cells_width, cells_height = frame.cells_height;
    const int cell_x = get_global_id(0), cell_y = get_global_id(1);
    if (cell_x >= cells_width || cell_y >= cells_height) return;
    const int plane = cells_width * cells_height, cell = cell_y * cells_width + cell_x;
    const float whole = (float)((reach + 1) * (reach + 1) * (reach + 1) * (reach + 1)); /* sum of all weights */
    float sum[CHANGES];
    for (int c = 0; c < CHANGES; ++c) {
        sum[c] = 0.0f;
        for (int y = max(cell_y - reach, 0); y <= min(cell_y + reach, cells_height - 1); ++y)
            sum[c] += (float)(reach + 1 - abs(y - cell_y)) * blurred[c * plane + y * cells_width + cell_x];
    }
    const float least = LEAST_SHARE * whole, share = fmax(sum[3], least);
    for (int c = 0; c < 3; ++c) trend[c * plane + cell] = divide(sum[c], share);
    trend[3 * plane + cell] = divide(sum[3], whole);
}

/* The four cells around positions in a rendered image, and their weights; 0 behind the camera. */
typedef struct { Ints tap[4]; Floats weight[4]; } Cells;

inline Cells cells_at(const Wide3 px, const int cells_width, const int cells_height) {
    const Floats x = clamp(px.x * (1.0f / CELL) - 0.5f, (Floats)(0.0f), (Floats)((float)(cells_width - 1)));
    const Floats y = clamp(px.y * (1.0f / CELL) - 0.5f, (Floats)(0.0f), (Floats)((float)(cells_height - 1)));
    const Ints x0 = to_ints(x), y0 = to_ints(y), right = min(x0 + 1, (Ints)(cells_width - 1)) - x0;
    const Ints down = (min(y0 + 1, (Ints)(cells_height - 1)) - y0) * cells_width;
    const Floats u = x - to_floats(x0), v = y - to_floats(y0), shown = px.z > 0.0f ? (Floats)(1.0f) : (Floats)(0.0f);
    Cells c;
    c.tap[0] = y0 * cells_width + x0;
    c.tap[1] = c.tap[0] + right;
    c.tap[2] = c.tap[0] + down;
    c.tap[3] = c.tap[2] + right;
    c.weight[0] = shown * (1.0f - u) * (1.0f - v);
    c.weight[1] = shown * u * (1.0f - v);
    c.weight[2] = shown * (1.0f - u) * v;
    c.weight[3] = shown * u * v;
    return c;
}

inline Floats trend_at(__global const float *plane, const Cells *c) {
    return (c->weight[0] * gather_floats(plane, c->tap[0]) + c->weight[1] * gather_floats(plane, c->tap[1]))
           + (c->weight[2] * gather_floats(plane, c->tap[2]) + c->weight[3] * gather_floats(plane, c->tap[3]));
}

/* What the trends of the last two intervals come to by t + alpha, each looked up where the pixel's surface, if it is static, was
   seen then, and the share of the last one; and how brightness changed close by in the interval before. */
WIDE __kernel void carry_trends(const Frame frame, __global const float *depth, __global const float *trend,
                                __global const float *trend_prev, __global const float *changes_prev,
                                __global float *trends) {
    const int target_width = frame.target_width, target_height = frame.target_height;
    const int width = frame.network_width / 2, height = frame.network_height / 2;
    const int cells_width = frame.cells_width, cells_height = frame.cells_height;
    const float alpha = frame.alpha;
    const Reprojection to_source = frame.to_source;
    const Reprojection to_previous = frame.target_to_previous;
    const int x = get_global_id(0) * LANES, y = get_global_id(1);
    if (x >= width || y >= height) return;
    const Ints dst_x = min(4 * (x + LANE_NUMBERS) + 2, (Ints)(target_width - 1));
    const int dst_y = min(4 * y + 2, target_height - 1);
    const Floats z = gather_floats(depth, dst_y * target_width + dst_x);
    const Floats px_x = to_floats(dst_x) + 0.5f, px_y = (float)dst_y + 0.5f;
    const Cells now = cells_at(wide_reproject(px_x, px_y, z, to_source), cells_width, cells_height);
    const Cells before = cells_at(wide_reproject(px_x, px_y, z, to_previous), cells_width, cells_height);
    const int plane = cells_width * cells_height, size = width * height;
    __global float *out = trends + y * width + x;
    for (int c = 0; c < 3; ++c) {
        store_floats(alpha * trend_at(trend + c * plane, &now), 0, out + c * size);
        store_floats(alpha * trend_at(trend_prev + c * plane, &before), 0, out + (3 + c) * size);
    }
    store_floats(trend_at(trend + 3 * plane, &now), 0, out + 6 * size);
    const Floats share = trend_at(changes_prev + 3 * plane, &before), least = wide_greater(share, (Floats)(LEAST_SHARE));
    Floats change = 0.0f;
    for (int c = 0; c < 3; ++c) change += trend_at(changes_prev + c * plane, &before);
    store_floats(wide_divide(THIRD * change, least), 0, out + 7 * size);
}
