/* Sizes, and the values that kernels receive. */
#include <math.h>
#include <string.h>

#include "gffe_internal.h"

cl_float4 gffe_floats(double x, double y, double z, double w) {
    cl_float4 made;
    made.s[0] = (float)x;
    made.s[1] = (float)y;
    made.s[2] = (float)z;
    made.s[3] = (float)w;
    return made;
}

static size_t rounded_up(size_t n, size_t side) { return (n + side - 1) / side; }

size_t gffe_aligned(const gffe_step *step, size_t n) { return rounded_up(n, step->alignment) * step->alignment; }

size_t gffe_level_start(const gffe_step *step, int level) {
    size_t start = 0;
    int k;
    for (k = 0; k < level; ++k) {
        const size_t side = (size_t)1 << k;
        start +=
            gffe_aligned(step, rounded_up((size_t)step->source[0], side) * rounded_up((size_t)step->source[1], side));
    }
    return start;
}

void gffe_grid_size(const gffe_step *step, int number, size_t size[2]) {
    const gffe_grid *grid = &gffe_grids[number];
    const int *image = grid->is_of_source ? step->source : step->target;
    int k;
    for (k = 0; k < 2; ++k) size[k] = rounded_up((size_t)image[k], grid->texel[k] * grid->multiple) * grid->multiple;
    if (grid->is_flat || grid->levels) {
        size[0] = grid->levels ? gffe_level_start(step, grid->levels) : size[0] * size[1];
        size[1] = 1;
    }
    if (grid->columns) size[0] = grid->columns;
    for (k = 0; k < 2; ++k) {
        if (grid->most[k] && size[k] > grid->most[k]) size[k] = grid->most[k];
        size[k] += grid->more[k];
    }
}

size_t gffe_buffer_bytes(const gffe_step *step, const gffe_buffer *buffer) {
    const size_t border = (size_t)buffer->border;
    size_t size[2];
    gffe_grid_size(step, buffer->grid, size);
    return (size[0] + 2 * border) * (size[1] + 2 * border) * (size_t)buffer->bytes * (size_t)buffer->planes;
}

/* Computes the reprojection for kernels: source view space -> target view space, three rows; both projections, and the
   source's inverse. */
static void reprojection(const gffe_camera *source, const gffe_camera *target, cl_float4 made[6]) {
    double rows[3][4];
    int k;
    gffe_view_transform(source, target, rows);
    for (k = 0; k < 3; ++k) made[k] = gffe_floats(rows[k][0], rows[k][1], rows[k][2], rows[k][3]);
    made[3] = gffe_floats(source->fx, source->fy, source->cx, source->cy);
    made[4] = gffe_floats(1 / source->fx, 1 / source->fy, source->cx, source->cy);
    made[5] = gffe_floats(target->fx, target->fy, target->cx, target->cy);
}

/* Returns scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`, which have one pose. */
static cl_float4 mapping(const gffe_camera *a, const gffe_camera *b) {
    const double scale_x = b->fx / a->fx, scale_y = b->fy / a->fy;
    return gffe_floats(scale_x, scale_y, b->cx - scale_x * a->cx, b->cy - scale_y * a->cy);
}

/* Computes the Lagrange weights of P_i - P_0 for every order that the times allow, one after
   another (gffe_cl/engine/stages/frame_block.py). */
static void polynomial(const gffe_step *step, int most, float *weights) {
    int order, i, k;
    memset(weights, 0, (size_t)(most * (most + 1) / 2) * sizeof *weights);
    for (order = 1; order <= most && order < step->time_count; ++order)
        for (i = 1; i <= order; ++i) {
            const double node = step->times[i] - step->times[0];
            double weight = 1;
            for (k = 0; k <= order; ++k) {
                const double other = step->times[k] - step->times[0];
                if (k != i) weight *= (step->time - step->times[0] - other) / (node - other);
            }
            weights[order * (order - 1) / 2 + i - 1] = (float)weight;
        }
}

static void level_starts(const gffe_step *step, int levels, cl_int *made) {
    int k;
    for (k = 0; k < GFFE_MAX_LEVELS; ++k) made[k] = (cl_int)gffe_level_start(step, k + 1 < levels ? k + 1 : levels);
}

static void grid_sides(const gffe_step *step, int grid, cl_int *width, cl_int *height) {
    size_t size[2];
    gffe_grid_size(step, grid, size);
    *width = (cl_int)size[0];
    *height = (cl_int)size[1];
}

int gffe_stays(const gffe_step *step) {
    gffe_frame_block facts;
    memcpy(&facts, gffe_facts, sizeof facts);
    return facts.copies && step->time_count > 1 && step->source[0] == step->target[0]
           && step->source[1] == step->target[1]
           && gffe_see_alike(&step->cameras[GFFE_FRAME], &step->cameras[GFFE_TARGET_CAMERA]);
}

/* Computes width and height of depth and motion. */
void gffe_geometry_of(const gffe_format *format, const int source[2], int size[2]) {
    size[0] = format->geometry_width ? format->geometry_width : source[0];
    size[1] = format->geometry_height ? format->geometry_height : source[1];
}

/* Returns whether geometry is smaller than color. */
int gffe_is_small(const gffe_step *step) {
    int size[2];
    gffe_geometry_of(&step->format, step->source, size);
    return size[0] != step->source[0] || size[1] != step->source[1];
}

/* Rounds a value to the numbers that a type holds, to even. */
static double stored(double value, int type) {
    const double most = gffe_type_most[type];
    int exponent;
    double unit;
    if (type == GFFE_FLOAT32) return (double)(float)value;
    if (type != GFFE_FLOAT16) return rint(value * most);
    frexp(value, &exponent);
    unit = ldexp(1, exponent - 11 > -24 ? exponent - 11 : -24);
    value = rint(value / unit) * unit;
    return fabs(value) > 65504 ? copysign(INFINITY, value) : value;
}

static void fill_given(const gffe_step *step, gffe_frame_block *block) {
    const gffe_format *format = &step->format;
    const double most = step->has_motion ? gffe_type_most[format->motion_type] : 1;
    const double sign = format->motion_from_previous ? -1 : 1;
    const int swapped = format->near_z > format->far_z;
    const double farthest = swapped ? format->near_z : format->far_z,
                 nearest = swapped ? format->far_z : format->near_z;
    const double far_value = format->depth_range[!swapped], near_value = format->depth_range[swapped];
    const double depth_most = gffe_type_most[format->depth_type];
    int k, geometry[2];
    gffe_geometry_of(format, step->source, geometry);
    block->geometry_width = geometry[0];
    block->geometry_height = geometry[1];
    for (k = 0; k < 2; ++k) {
        const double side = step->source[k], scale = side / geometry[k];
        const double shift = gffe_is_small(step) ? step->jitter[k] : 0;
        const double units[] = {scale, side, side / 2, 1}; /* GFFE_PIXELS, GFFE_UV ... */
        const double unit = units[format->motion_unit];
        const double factor = sign * unit * (k && format->motion_y_up ? -1 : 1);
        const double jitter = format->motion_jittered ? step->jitter[k] - step->previous_jitter[k] : 0;
        block->given_motion.s[k] = (float)(factor * format->motion_scale[k] / most);
        block->given_motion.s[2 + k] = (float)(factor * format->motion_offset[k] + jitter);
        block->to_geometry.s[k] = (float)(1 / scale);
        block->to_geometry.s[2 + k] = (float)(shift / scale);
        block->from_geometry.s[k] = (float)scale;
        block->from_geometry.s[2 + k] = (float)-shift;
    }
    if (format->depth == GFFE_DEVICE) {
        const double factor = (1 / nearest - 1 / farthest) / (near_value - far_value) / depth_most;
        block->given_depth = gffe_floats(factor, far_value * depth_most, 1 / farthest, far_value * depth_most);
    } else if (format->depth == GFFE_LOGARITHMIC) {
        const double above = nearest > 0 ? 0 : 1;
        const double factor = log((farthest + above) / (nearest + above)) / (far_value - near_value) / depth_most;
        block->given_depth = gffe_floats(factor, near_value * depth_most, nearest, far_value * depth_most);
    } else {
        const double factor = (farthest - nearest) / (far_value - near_value) / depth_most, scale = format->depth_scale;
        block->given_depth = gffe_floats(factor * scale, near_value * depth_most, nearest * scale, NAN);
    }
    block->motion_invalid = NAN;
    if (step->has_motion && !isnan(format->motion_invalid))
        block->motion_invalid = (float)stored(format->motion_invalid, format->motion_type);
    block->given_types.s[GFFE_COLOR] = format->color_type;
    block->given_types.s[GFFE_DEPTH] = format->depth_type;
    block->given_types.s[GFFE_MOTION] = step->has_motion ? format->motion_type : 0;
    block->given_types.s[3] = format->camera_motion;
    block->given_channels.s[0] = format->color_channels;
    block->given_channels.s[1] = format->motion_channels;
    block->depth_law = format->depth;
    block->rows_up = format->rows_up != 0;
    block->color_srgb = format->color_srgb != 0;
    block->has_previous = step->converts_after;
}

/* Fills the frame block as gffe_cl/engine/stages/frame_block.py does. */
void gffe_fill_frame_block(const gffe_step *step, int is_new, gffe_frame_block *block) {
    const gffe_camera *source = &step->cameras[GFFE_FRAME], *previous = &step->cameras[GFFE_PREVIOUS];
    const gffe_camera *target = &step->cameras[GFFE_TARGET_CAMERA], *display = &step->cameras[GFFE_FRAME_DISPLAY];
    const double gain = GFFE_MU * step->exposure / GFFE_HEADROOM, scale = log1p(GFFE_MU);
    int k;
    memcpy(block, gffe_facts, sizeof *block);
    if (block->levels > 0) level_starts(step, block->levels, block->level_starts.s);
    grid_sides(step, GFFE_SOURCE, &block->source_width, &block->source_height);
    grid_sides(step, GFFE_TARGET, &block->target_width, &block->target_height);
    grid_sides(step, GFFE_NETWORK, &block->network_width, &block->network_height);
    grid_sides(step, GFFE_CELLS, &block->cells_width, &block->cells_height);
    reprojection(source, previous, block->to_previous);
    reprojection(previous, source, block->from_previous);
    block->to_render = mapping(display, source);
    block->to_display = mapping(source, display);
    block->to_previous_display = mapping(previous, &step->cameras[GFFE_PREVIOUS_DISPLAY]);
    for (k = 0; k < 2; ++k) block->pixel_size.s[k] = 1 / block->to_render.s[k];
    block->camera_step = (float)gffe_distance(source, previous);
    block->has_previous = step->time_count > 1;
    block->number = step->number;
    block->rests = block->motion ? step->rests : 0;
    block->coded = step->coded;
    block->stays = is_new && step->stays;
    block->interval_ratio = 1;
    if (step->time_count > 2)
        block->interval_ratio = (float)((step->times[0] - step->times[1]) / (step->times[1] - step->times[2]));
    block->exposure = (float)step->exposure;
    block->code_offset = (float)(block->code_offset / sqrt(fmax(step->exposure, 1.0 / 65504)));
    block->alpha = (float)step->alpha;
    block->color_law = gffe_floats(gain, 1 / scale, 1 / gain, scale);
    if (block->order > step->time_count - 1) block->order = step->time_count - 1;
    for (k = 0; k < 4; ++k) block->has_overlays |= step->has[k] << k;
    if (step->converts) fill_given(step, block);
    if (!is_new) return;
    reprojection(source, target, block->to_target);
    reprojection(target, source, block->to_source);
    reprojection(target, previous, block->target_to_previous);
    block->zoom.s[0] = (float)(target->fx / source->fx); /* pixels per pixel of points as far from both cameras */
    block->zoom.s[1] = (float)(target->fy / source->fy);
    polynomial(step, GFFE_MOST_TIMES - 1, (float *)block->polynomial);
}
