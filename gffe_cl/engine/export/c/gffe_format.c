/* Buffers in an engine's own formats (gffe_cl/engine/frame/frame_format.py). */
#include <math.h>
#include <string.h>

#include "gffe_internal.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

gffe_format gffe_default_format(void) {
    gffe_format made;
    memset(&made, 0, sizeof made);
    made.color_type = GFFE_FLOAT16;
    made.color_channels = 4;
    made.depth_type = made.motion_type = GFFE_FLOAT32;
    made.far_z = made.depth_range[1] = made.depth_scale = 1;
    made.motion_channels = 2;
    made.motion_scale[0] = made.motion_scale[1] = 1;
    made.motion_invalid = NAN;
    return made;
}

/* The stored number that stands for 1. */
static double most_of(int type) {
    return type == GFFE_UNORM8    ? 255.0
           : type == GFFE_UNORM16 ? 65535.0
           : type == GFFE_SNORM16 ? 32767.0
           : type == GFFE_UNORM24 ? 16777215.0
                                  : 1.0;
}

static size_t bytes_of(int type) {
    return type == GFFE_UNORM8 ? 1 : type == GFFE_FLOAT32 || type == GFFE_UNORM24 ? 4 : 2;
}

size_t gffe_texel_bytes(const gffe_format *format, int buffer) {
    if (buffer == GFFE_DEPTH) return bytes_of(format->depth_type);
    if (buffer == GFFE_COLOR) return bytes_of(format->color_type) * (size_t)format->color_channels;
    return bytes_of(format->motion_type) * (size_t)format->motion_channels;
}

int gffe_is_color_ours(const gffe_format *format) {
    return format->color_type == GFFE_FLOAT16 && format->color_channels == 4 && !format->color_srgb && !format->rows_up;
}

void gffe_geometry_of(const gffe_format *format, const int source[2], int size[2]) {
    size[0] = format->geometry_width ? format->geometry_width : source[0];
    size[1] = format->geometry_height ? format->geometry_height : source[1];
}

int gffe_is_small(const gffe_step *step) {
    int size[2];
    gffe_geometry_of(&step->format, step->source, size);
    return size[0] != step->source[0] || size[1] != step->source[1];
}

int gffe_is_geometry_ours(const gffe_step *step) {
    const gffe_format *format = &step->format;
    return !gffe_is_small(step) && !format->rows_up && format->depth_type == GFFE_FLOAT32
           && format->depth == GFFE_LINEAR && format->depth_scale == 1 && format->near_z == 0 && format->far_z == 1
           && format->depth_range[0] == 0 && format->depth_range[1] == 1 && format->motion_type == GFFE_FLOAT32
           && format->motion_channels == 2 && format->motion_scale[0] == 1 && format->motion_scale[1] == 1
           && format->motion_offset[0] == 0 && format->motion_offset[1] == 0 && format->motion_unit == GFFE_PIXELS
           && !format->motion_from_previous && !format->motion_y_up && !format->motion_dilated
           && !format->motion_jittered && isnan(format->motion_invalid)
           && format->camera_motion == GFFE_CAMERA_INCLUDED;
}

static gffe_status need_finite(gffe *g, const char *name, double value) {
    return gffe_need_number(g, name, value, -GFFE_LARGEST, GFFE_LARGEST);
}

static gffe_status need_pair(gffe *g, const char *name, const double pair[2]) {
    const gffe_status status = need_finite(g, name, pair[0]);
    return status ? status : need_finite(g, name, pair[1]);
}

/* Refuses a plane unless it is finite or, of device depth, infinitely far. */
static gffe_status need_plane(gffe *g, const char *name, double z, int is_device) {
    return is_device && z == HUGE_VAL ? GFFE_OK : need_finite(g, name, z);
}

static gffe_status check_numbers(gffe *g, const gffe_format *f) {
    gffe_status status = gffe_need_whole(g, "format: geometry_width", f->geometry_width, 0, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_whole(g, "format: geometry_height", f->geometry_height, 0, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_whole(g, "format: color_channels", f->color_channels, 3, 4);
    if (!status) status = gffe_need_whole(g, "format: motion_channels", f->motion_channels, 2, 4);
    if (!status) status = gffe_need_whole(g, "format: depth", f->depth, GFFE_LINEAR, GFFE_DISTANCE);
    if (!status) status = gffe_need_whole(g, "format: motion_unit", f->motion_unit, GFFE_PIXELS, GFFE_COLOR_PIXELS);
    if (!status)
        status =
            gffe_need_whole(g, "format: camera_motion", f->camera_motion, GFFE_CAMERA_INCLUDED, GFFE_CAMERA_EXCLUDED);
    if (!status) status = need_plane(g, "format: near_z", f->near_z, f->depth == GFFE_DEVICE);
    if (!status) status = need_plane(g, "format: far_z", f->far_z, f->depth == GFFE_DEVICE);
    if (!status) status = need_finite(g, "format: depth_scale", f->depth_scale);
    if (!status) status = need_pair(g, "format: depth_range", f->depth_range);
    if (!status) status = need_pair(g, "format: motion_scale", f->motion_scale);
    if (!status) status = need_pair(g, "format: motion_offset", f->motion_offset);
    if (!status && !isnan(f->motion_invalid)) status = need_finite(g, "format: motion_invalid", f->motion_invalid);
    return status;
}

static gffe_status check_type(gffe *g, const char *name, int type, const int *allowed, int count) {
    int k;
    for (k = 0; k < count; ++k)
        if (type == allowed[k]) return GFFE_OK;
    return gffe_fail(g, GFFE_INVALID, "format: %s_type must be one that such buffers can have (gffe.h), got %d", name,
                     type);
}

gffe_status gffe_check_format(gffe *g, const gffe_format *format) {
    static const int colors[4] = {GFFE_FLOAT16, GFFE_FLOAT32, GFFE_UNORM16, GFFE_UNORM8};
    static const int depths[3] = {GFFE_FLOAT32, GFFE_UNORM16, GFFE_UNORM24};
    static const int motions[4] = {GFFE_FLOAT32, GFFE_FLOAT16, GFFE_UNORM16, GFFE_SNORM16};
    const double near_z = format->near_z, far_z = format->far_z, nearer = near_z < far_z ? near_z : far_z;
    gffe_status status = check_type(g, "color", format->color_type, colors, 4);
    if (!status) status = check_type(g, "depth", format->depth_type, depths, 3);
    if (!status) status = check_type(g, "motion", format->motion_type, motions, 4);
    if (!status) status = check_numbers(g, format);
    if (status) return status;
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

/* Rounds a value to the numbers that a type holds, to even. */
static double stored(double value, int type) {
    const double most = most_of(type);
    int exponent;
    double unit;
    if (type == GFFE_FLOAT32) return (double)(float)value;
    if (type != GFFE_FLOAT16) return rint(value * most);
    frexp(value, &exponent);
    unit = ldexp(1, exponent - 11 > -24 ? exponent - 11 : -24);
    value = rint(value / unit) * unit;
    return fabs(value) > 65504 ? copysign(INFINITY, value) : value;
}

void gffe_fill_given(const gffe_step *step, gffe_frame_block *block) {
    const gffe_format *format = &step->format;
    const double most = step->has_motion ? most_of(format->motion_type) : 1;
    const double sign = format->motion_from_previous ? -1 : 1;
    const int swapped = format->near_z > format->far_z;
    const double farthest = swapped ? format->near_z : format->far_z,
                 nearest = swapped ? format->far_z : format->near_z;
    const double far_value = format->depth_range[!swapped], near_value = format->depth_range[swapped];
    const double depth_most = most_of(format->depth_type);
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
        block->given_depth.s[0] = (float)((1 / nearest - 1 / farthest) / (near_value - far_value) / depth_most);
        block->given_depth.s[1] = block->given_depth.s[3] = (float)(far_value * depth_most);
        block->given_depth.s[2] = (float)(1 / farthest);
    } else if (format->depth == GFFE_LOGARITHMIC) {
        const double above = nearest > 0 ? 0 : 1;
        block->given_depth.s[0] =
            (float)(log((farthest + above) / (nearest + above)) / (far_value - near_value) / depth_most);
        block->given_depth.s[1] = (float)(near_value * depth_most);
        block->given_depth.s[2] = (float)nearest;
        block->given_depth.s[3] = (float)(far_value * depth_most);
    } else {
        const double factor = (farthest - nearest) / (far_value - near_value) / depth_most;
        block->given_depth.s[0] = (float)(factor * format->depth_scale);
        block->given_depth.s[1] = (float)(near_value * depth_most);
        block->given_depth.s[2] = (float)(nearest * format->depth_scale);
        block->given_depth.s[3] = NAN;
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
