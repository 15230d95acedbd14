/* Sizes, and the values that kernels receive. */
#include <math.h>
#include <string.h>

#include "gffe_internal.h"

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
static void reprojection(const gffe_camera *source, const gffe_camera *target, float made[24]) {
    double matrix[3][4];
    int i, j;
    gffe_view_transform(source, target, matrix);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 4; ++j) made[4 * i + j] = (float)matrix[i][j];
    made[12] = (float)source->fx;
    made[13] = (float)source->fy;
    made[14] = (float)source->cx;
    made[15] = (float)source->cy;
    made[16] = (float)(1 / source->fx);
    made[17] = (float)(1 / source->fy);
    made[18] = (float)source->cx;
    made[19] = (float)source->cy;
    made[20] = (float)target->fx;
    made[21] = (float)target->fy;
    made[22] = (float)target->cx;
    made[23] = (float)target->cy;
}

/* Computes the target pixels per source pixel of points equally far from both cameras. */
static void zoom(const gffe_camera *source, const gffe_camera *target, float made[2]) {
    made[0] = (float)(target->fx / source->fx);
    made[1] = (float)(target->fy / source->fy);
}

/* Computes scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`, which have one pose. */
static void mapping(const gffe_camera *a, const gffe_camera *b, float made[4]) {
    const double scale_x = b->fx / a->fx, scale_y = b->fy / a->fy;
    made[0] = (float)scale_x;
    made[1] = (float)scale_y;
    made[2] = (float)(b->cx - scale_x * a->cx);
    made[3] = (float)(b->cy - scale_y * a->cy);
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

static void color_law(double exposure, float *made) {
    const double gain = GFFE_MU * exposure / GFFE_HEADROOM, scale = log1p(GFFE_MU);
    made[0] = (float)gain;
    made[1] = (float)(1 / scale);
    made[2] = (float)(1 / gain);
    made[3] = (float)scale;
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

/* Fills the frame block as gffe_cl/engine/stages/frame_block.py does. */
void gffe_fill_frame_block(const gffe_step *step, int is_new, gffe_frame_block *block) {
    const gffe_camera *source = &step->cameras[GFFE_FRAME], *previous = &step->cameras[GFFE_PREVIOUS];
    const gffe_camera *target = &step->cameras[GFFE_TARGET_CAMERA], *display = &step->cameras[GFFE_FRAME_DISPLAY];
    int k;
    memcpy(block, gffe_facts, sizeof *block);
    if (block->levels > 0) level_starts(step, block->levels, block->level_starts.s);
    grid_sides(step, GFFE_SOURCE, &block->source_width, &block->source_height);
    grid_sides(step, GFFE_TARGET, &block->target_width, &block->target_height);
    grid_sides(step, GFFE_NETWORK, &block->network_width, &block->network_height);
    grid_sides(step, GFFE_CELLS, &block->cells_width, &block->cells_height);
    reprojection(source, previous, (float *)&block->to_previous);
    reprojection(previous, source, (float *)&block->from_previous);
    mapping(display, source, block->to_render.s);
    mapping(source, display, block->to_display.s);
    mapping(previous, &step->cameras[GFFE_PREVIOUS_DISPLAY], block->to_previous_display.s);
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
    color_law(step->exposure, block->color_law.s);
    if (block->order > step->time_count - 1) block->order = step->time_count - 1;
    for (k = 0; k < 4; ++k) block->has_overlays |= step->has[k] << k;
    if (step->converts) gffe_fill_given(step, block);
    if (!is_new) return;
    reprojection(source, target, (float *)&block->to_target);
    reprojection(target, source, (float *)&block->to_source);
    reprojection(target, previous, (float *)&block->target_to_previous);
    zoom(source, target, block->zoom.s);
    polynomial(step, GFFE_MOST_TIMES - 1, (float *)block->polynomial);
}
