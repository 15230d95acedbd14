/* Buffers in an engine's own formats (gffe_cl/engine/frame/frame_format.py), and their conversion into a rendered
   frame's. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "gffe_internal.h"

static double value_of(const gffe_format *format, const gffe_field *field) {
    const char *at = (const char *)format + field->at;
    double number;
    int whole;
    memcpy(&whole, at, sizeof whole);
    if (field->kind < GFFE_REAL) return field->kind == GFFE_FLAG ? whole != 0 : whole;
    memcpy(&number, at, sizeof number);
    return number;
}

gffe_format gffe_default_format(void) {
    gffe_format made;
    int k;
    memset(&made, 0, sizeof made);
    for (k = 0; k < gffe_field_count; ++k) {
        const gffe_field *field = &gffe_fields[k];
        char *at = (char *)&made + field->at;
        const int whole = field->kind < GFFE_REAL ? (int)field->usual : 0;
        if (field->kind < GFFE_REAL)
            memcpy(at, &whole, sizeof whole);
        else
            memcpy(at, &field->usual, sizeof field->usual);
    }
    return made;
}

/* Returns whether these buffers are as the stages read them. */
static int are_ours(const gffe_format *format, int buffers) {
    int k;
    for (k = 0; k < gffe_field_count; ++k) {
        const double value = value_of(format, &gffe_fields[k]), usual = gffe_fields[k].usual;
        if (gffe_fields[k].buffers & buffers && value != usual && !(isnan(value) && isnan(usual))) return 0;
    }
    return 1;
}

static size_t texel_bytes(const gffe_format *format, int buffer) {
    if (buffer == GFFE_DEPTH) return gffe_type_bytes[format->depth_type];
    if (buffer == GFFE_COLOR) return gffe_type_bytes[format->color_type] * (size_t)format->color_channels;
    return gffe_type_bytes[format->motion_type] * (size_t)format->motion_channels;
}

static gffe_status check_field(gffe *g, const gffe_format *format, const gffe_field *field) {
    const double value = value_of(format, field);
    char name[64];
    snprintf(name, sizeof name, "format: %s", field->name);
    if (field->types && !(value >= field->least && value <= field->most && field->types >> (int)value & 1))
        return gffe_fail(g, GFFE_INVALID, "%s must be one that such buffers can have (gffe.h), got %g", name, value);
    if (field->kind == GFFE_FLAG || (field->kind == GFFE_OPTIONAL && isnan(value))) return GFFE_OK;
    if (field->kind == GFFE_WHOLE) return gffe_need_whole(g, name, (int)value, field->least, field->most);
    if (field->kind == GFFE_PLANE && format->depth == GFFE_DEVICE && value == HUGE_VAL) return GFFE_OK;
    return gffe_need_number(g, name, value, -GFFE_LARGEST, GFFE_LARGEST);
}

static gffe_status check_format(gffe *g, const gffe_format *format) {
    const double near_z = format->near_z, far_z = format->far_z, nearer = near_z < far_z ? near_z : far_z;
    int k;
    for (k = 0; k < gffe_field_count; ++k) {
        const gffe_status status = check_field(g, format, &gffe_fields[k]);
        if (status) return status;
    }
    if (!format->geometry_width != !format->geometry_height)
        return gffe_fail(g, GFFE_INVALID,
                         "format: geometry_width and geometry_height must be 0 both or neither, got %d and %d",
                         format->geometry_width, format->geometry_height);
    if (near_z == far_z || format->depth_range[0] == format->depth_range[1])
        return gffe_fail(g, GFFE_INVALID,
                         "format: near_z and far_z must differ, and so must depth_range, got near_z %g, far_z %g",
                         near_z, far_z);
    if (!(format->depth_scale > 0))
        return gffe_fail(g, GFFE_INVALID, "format: depth_scale must be greater than 0, got %g", format->depth_scale);
    if (format->depth_scale != 1 && (format->depth == GFFE_DEVICE || format->depth == GFFE_LOGARITHMIC))
        return gffe_fail(g, GFFE_INVALID,
                         "format: depth_scale must be 1 with device or logarithmic depth, whose near_z and far_z are in"
                         " world units, got %g",
                         format->depth_scale);
    if (format->depth == GFFE_DEVICE && !(near_z > 0 && far_z > 0))
        return gffe_fail(g, GFFE_INVALID,
                         "format: device depth needs near_z and far_z greater than 0, got near_z %g, far_z %g", near_z,
                         far_z);
    if (format->depth == GFFE_LOGARITHMIC
        && (!(nearer >= 0) || fmax(near_z, far_z) > GFFE_MOST_PLANES * (nearer > 0 ? nearer : 1)))
        return gffe_fail(
            g, GFFE_INVALID,
            "format: logarithmic depth needs near_z and far_z of 0 or more, up to %g times apart, got near_z"
            " %g, far_z %g",
            GFFE_MOST_PLANES, near_z, far_z);
    if (format->motion_scale[0] == 0 || format->motion_scale[1] == 0)
        return gffe_fail(g, GFFE_INVALID, "format: motion_scale must not contain 0, got %g and %g",
                         format->motion_scale[0], format->motion_scale[1]);
    if (format->camera_motion == GFFE_CAMERA_MOVERS_ONLY && isnan(format->motion_invalid))
        return gffe_fail(
            g, GFFE_INVALID,
            "format: camera_motion GFFE_CAMERA_MOVERS_ONLY needs motion_invalid, the value without a vector");
    return GFFE_OK;
}

/* ---- conversion ---------------------------------------------------------------------------------------- */

static const char *const NAMES[GFFE_BUFFERS] = {"color", "depth", "motion"};

gffe_status gffe_set_format(gffe *g, const gffe_format *format) {
    gffe_status status = gffe_need(g, g, "gffe");
    int size[2], k;
    if (!status && format) status = check_format(g, format);
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
        const size_t texel = texel_bytes(&step->format, k);
        gffe_status status;
        if (k == GFFE_MOTION && !buffers[k]) continue;
        status = gffe_check_bytes(g, buffers[k], NAMES[k], k == GFFE_COLOR ? step->source : geometry, texel);
        if (status) return status;
    }
    return GFFE_OK;
}

/* Makes color and depth of two converted frames, and one motion, for nothing reads that of the frame before. */
static gffe_status need_converted(gffe *g) {
    static const size_t texels[GFFE_BUFFERS] = {8, 4, 8};
    const size_t pixels = (size_t)g->step.source[0] * (size_t)g->step.source[1];
    cl_int error = CL_SUCCESS;
    int k;
    for (k = 0; k < GFFE_CONVERTED && !g->converted[k] && error == CL_SUCCESS; ++k)
        g->converted[k] = clCreateBuffer(g->context, CL_MEM_READ_WRITE, texels[k / 2] * pixels, NULL, &error);
    return gffe_checked(g, error, "a buffer for a converted frame");
}

gffe_status gffe_prepare_formatted(gffe *g, const cl_mem given[3], cl_mem frame[3]) {
    const int color = !are_ours(&g->step.format, GFFE_OF_COLOR),
              geometry = gffe_is_small(&g->step) || !are_ours(&g->step.format, GFFE_OF_GEOMETRY);
    gffe_status status;
    int k;
    g->converts[0] = color;
    g->converts[1] = geometry;
    for (k = 0; k < GFFE_BUFFERS; ++k) frame[k] = given[k];
    if (!color && !geometry) return GFFE_OK;
    g->turn = !g->turn;
    status = need_converted(g);
    for (k = 0; k < GFFE_BUFFERS && !status; ++k)
        if (k == GFFE_COLOR ? color : geometry) frame[k] = g->converted[k == GFFE_MOTION ? 2 * k : 2 * k + g->turn];
    return status;
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
        status = gffe_run(g, GFFE_CONVERT_GEOMETRY + gffe_is_small(step) + 2 * (step->format.motion_dilated != 0));
    step->converts = 0;
    for (k = 0; k < GFFE_BUFFERS; ++k) g->memory[GFFE_ENGINE_COLOR + 2 * k] = NULL;
    return status;
}
