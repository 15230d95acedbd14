/* Conversion of buffers in an engine's own formats into a rendered frame's. */

#include "gffe_internal.h"

static const char *const NAMES[GFFE_BUFFERS] = {"color", "depth", "motion"};

gffe_status gffe_set_format(gffe *g, const gffe_format *format) {
    gffe_status status = gffe_need(g, g, "gffe");
    int size[2], k;
    if (!status && format) status = gffe_check_format(g, format);
    if (status) return status;
    if (format) gffe_geometry_of(format, g->step.source, size);
    for (k = 0; k < 2 && format; ++k)
        if (size[k] < g->step.source[k] / GFFE_MOST_RATIO || size[k] > g->step.source[k])
            return gffe_fail(g, GFFE_INVALID,
                             "format: geometry is %dx%d and color %dx%d (expected depth and motion of the size of color"
                             " or up to %d times smaller, each way)",
                             size[0], size[1], g->step.source[0], g->step.source[1], GFFE_MOST_RATIO);
    g->has_format = format != NULL;
    if (!format) return GFFE_OK;
    g->step.format = *format;
    return g->memory[gffe_reference(g, "upload.bad_pixels")] ? GFFE_OK : gffe_open_late(g);
}

gffe_status gffe_set_geometry_jitter(gffe *g, double x, double y) {
    gffe_status status = gffe_need(g, g, "gffe");
    if (!status) status = gffe_need_number(g, "geometry jitter: x", x, -GFFE_MOST_JITTER, GFFE_MOST_JITTER);
    if (!status) status = gffe_need_number(g, "geometry jitter: y", y, -GFFE_MOST_JITTER, GFFE_MOST_JITTER);
    if (status) return status;
    g->jitter[0] = x;
    g->jitter[1] = y;
    return GFFE_OK;
}

gffe_status gffe_check_formatted(gffe *g, const cl_mem buffers[3]) {
    const gffe_step *step = &g->step;
    int k, geometry[2];
    gffe_geometry_of(&step->format, step->source, geometry);
    for (k = 0; k < GFFE_BUFFERS; ++k) {
        const size_t texel = gffe_texel_bytes(&step->format, k);
        gffe_status status;
        if (k == GFFE_MOTION && !buffers[k]) continue;
        status = gffe_check_bytes(g, buffers[k], NAMES[k], k == GFFE_COLOR ? step->source : geometry, texel);
        if (status) return status;
    }
    return GFFE_OK;
}

/* Makes the buffers of a converted frame: `turn` 0 and 1 have one motion, for nothing reads that of the frame before.
 */
static gffe_status need_converted(gffe *g, int turn) {
    static const size_t texels[GFFE_BUFFERS] = {8, 4, 8};
    int k;
    for (k = 0; k < GFFE_BUFFERS; ++k) {
        cl_int error;
        if (g->converted[turn][k]) continue;
        if (k == GFFE_MOTION && g->converted[!turn][k]) {
            g->converted[turn][k] = g->converted[!turn][k];
            clRetainMemObject(g->converted[turn][k]);
            continue;
        }
        g->converted[turn][k] =
            clCreateBuffer(g->context, CL_MEM_READ_WRITE,
                           texels[k] * (size_t)g->step.source[0] * (size_t)g->step.source[1], NULL, &error);
        if (!g->converted[turn][k]) return gffe_opencl_failed(g, error, "a buffer for a converted frame");
    }
    return GFFE_OK;
}

gffe_status gffe_prepare_formatted(gffe *g, const cl_mem given[3], cl_mem frame[3]) {
    const int color = !gffe_is_color_ours(&g->step.format), geometry = !gffe_is_geometry_ours(&g->step);
    int k;
    g->converts[0] = color;
    g->converts[1] = geometry;
    for (k = 0; k < GFFE_BUFFERS; ++k) frame[k] = given[k];
    if (!color && !geometry) return GFFE_OK;
    g->turn = !g->turn;
    if (need_converted(g, g->turn)) return GFFE_OUT_OF_MEMORY;
    for (k = 0; k < GFFE_BUFFERS; ++k)
        if (k == GFFE_COLOR ? color : geometry) frame[k] = g->converted[g->turn][k];
    return GFFE_OK;
}

gffe_status gffe_convert(gffe *g, const cl_mem given[3], int has_previous) {
    gffe_step *step = &g->step;
    gffe_status status = GFFE_OK;
    int k, geometry[2] = {step->source[0], step->source[1]};
    step->has_motion = given[GFFE_MOTION] != NULL;
    step->converts_after = has_previous;
    if (g->has_format) gffe_geometry_of(&step->format, step->source, geometry);
    for (k = 0; k < 2; ++k) {
        const double jitter = g->jitter[k] * ((double)step->source[k] / geometry[k]);
        step->previous_jitter[k] = has_previous ? step->jitter[k] : jitter;
        step->jitter[k] = jitter;
    }
    if (!g->has_format) return GFFE_OK;
    for (k = 0; k < GFFE_BUFFERS; ++k) g->memory[GFFE_ENGINE_COLOR + 2 * k] = given[k];
    if (!given[GFFE_MOTION]) g->memory[GFFE_ENGINE_COLOR + 2 * GFFE_MOTION] = g->memory[GFFE_RENDERED_MOTION];
    step->converts = 1;
    if (g->converts[0]) status = gffe_run(g, GFFE_CONVERT_COLOR);
    if (!status && g->converts[1])
        status = gffe_run(g, step->format.motion_dilated
                                 ? (gffe_is_small(step) ? GFFE_CONVERT_SMALL_DILATED : GFFE_CONVERT_DILATED)
                                 : (gffe_is_small(step) ? GFFE_CONVERT_SMALL : GFFE_CONVERT_GEOMETRY));
    step->converts = 0;
    for (k = 0; k < GFFE_BUFFERS; ++k) g->memory[GFFE_ENGINE_COLOR + 2 * k] = NULL;
    return status;
}

void gffe_drop_converted(gffe *g) {
    int turn, k;
    for (turn = 0; turn < 2; ++turn)
        for (k = 0; k < GFFE_BUFFERS; ++k)
            if (g->converted[turn][k]) clReleaseMemObject(g->converted[turn][k]);
}
