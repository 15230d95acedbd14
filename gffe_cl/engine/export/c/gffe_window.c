/* Adaptive rendering windows (gffe_cl/engine/frame/window.py). */
#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gffe_camera.h"
#include "gffe_config.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#define MOST_CORNERS 8

static double larger(double a, double b) { return b > a ? b : a; }

static double smaller(double a, double b) { return b < a ? b : a; }

static int is_side(double n) { return n >= GFFE_LEAST_SIDE && n <= GFFE_MOST_SIDE; }

gffe_window_options gffe_default_window_options(double width, double height) {
    gffe_window_options made;
    made.width = width;
    made.height = height;
    made.max_enlargement = GFFE_MAX_ENLARGEMENT;
    made.distance = HUGE_VAL;
    made.margin = GFFE_WINDOW_MARGIN;
    made.least = 0;
    return made;
}

/* Clips the cone of four edges to directions that meet the virtual plane, and how many they are then; `cut`: whether
   anything was cut off. */
static int in_front(double rays[4][3], double kept[MOST_CORNERS][3], int *cut) {
    double z[4];
    int i, j, k, count = 0, ahead = 1;
    for (i = 0; i < 4; ++i) {
        const double size = gffe_length(rays[i]);
        for (k = 0; k < 3; ++k) rays[i][k] = rays[i][k] / size;
        z[i] = rays[i][2] - GFFE_HORIZON;
        ahead = ahead && z[i] > 0;
    }
    *cut = !ahead;
    for (i = 0; i < 4; ++i) {
        j = (i + 1) % 4;
        if (z[i] > 0) {
            for (k = 0; k < 3; ++k) kept[count][k] = rays[i][k];
            ++count;
        }
        if ((z[i] > 0) != (z[j] > 0)) {
            const double share = z[i] / (z[i] - z[j]);
            for (k = 0; k < 3; ++k) kept[count][k] = rays[i][k] + (rays[j][k] - rays[i][k]) * share;
            ++count;
        }
    }
    if (!count) { /* nothing of it lies ahead: as far as may be, to the side it has turned to */
        for (i = 0; i < 4; ++i)
            for (k = 0; k < 3; ++k) kept[i][k] = k == 2 ? GFFE_HORIZON : rays[i][k];
        count = 4;
    }
    if (*cut)
        for (i = 0; i < count; ++i) kept[i][2] = larger(kept[i][2], GFFE_HORIZON);
    return count;
}

/* Widens low and high, in coordinates of the display, to where the edges of the frustum of `camera` meet the virtual
   plane, and to their vanishing points. */
static int cover(const gffe_camera *current, const gffe_camera *camera, const gffe_window_options *options,
                 double low[2], double high[2]) {
    const double size[2] = {options->width, options->height};
    const double focal[2] = {current->fx, current->fy}, center[2] = {current->cx, current->cy};
    const double px[4][2] = {{0, 0}, {size[0], 0}, {size[0], size[1]}, {0, size[1]}};
    double transform[3][4], rays[4][3], kept[MOST_CORNERS][3];
    int i, k, count, cut;
    gffe_view_transform(camera, current, transform);
    for (i = 0; i < 4; ++i) {
        const double x = (px[i][0] - camera->cx) / camera->fx, y = (px[i][1] - camera->cy) / camera->fy;
        for (k = 0; k < 3; ++k) rays[i][k] = transform[k][0] * x + transform[k][1] * y + transform[k][2] * 1.0;
    }
    count = in_front(rays, kept, &cut);
    for (i = 0; i < count; ++i) {
        for (k = 0; k < 2; ++k) {
            const double point = kept[i][k] / kept[i][2];
            double uv = 2 * (point * focal[k] + center[k]) / size[k] - 1;
            low[k] = smaller(low[k], uv);
            high[k] = larger(high[k], uv);
            if (options->distance <= DBL_MAX) {
                const double along = larger(options->distance - transform[2][3], 0);
                const double met = transform[k][3] + along * point;
                uv = 2 * (met / larger(options->distance, transform[2][3]) * focal[k] + center[k]) / size[k] - 1;
                low[k] = smaller(low[k], uv);
                high[k] = larger(high[k], uv);
            }
        }
    }
    return cut;
}

/* Computes how much to enlarge on two sides that ask for `low` and `high`, and returns whether that is less. */
static int limit(double *low, double *high, double most) {
    double less, rest;
    if (*low + *high <= most) return 0;
    less = smaller(smaller(*low, *high), most / 2);
    rest = most - less;
    if (*low <= *high) {
        *low = less;
        *high = rest;
    } else {
        *low = rest;
        *high = less;
    }
    return 1;
}

const char *gffe_adaptive_window(const gffe_camera *current, const gffe_camera *predicted, int count,
                                 const gffe_window_options *options, gffe_window *made) {
    double size[2], low[2] = {-1, -1}, high[2] = {1, 1};
    int i, k, clamped = 0;
    const char *fault = gffe_camera_fault(current);
    if (!options || !made || (!predicted && count > 0)) return "window: predicted, options and made must not be NULL";
    if (count < 0) return "window: count must not be negative";
    size[0] = options->width;
    size[1] = options->height;
    if (!(options->max_enlargement >= 1 && options->max_enlargement <= GFFE_MOST_OF_WINDOW))
        return "window: the maximum enlargement must be from 1 to 1e6";
    if (!(options->distance > 0 && (options->distance < GFFE_LARGEST || options->distance > DBL_MAX)))
        return "window: the distance of the virtual plane must be positive, and below 1e300 or infinite";
    if (!(options->margin >= 0 && options->margin <= GFFE_MOST_OF_WINDOW))
        return "window: the margin must be from 0 to 1e6 pixels";
    if (!(options->least >= 0 && options->least <= 1)) return "window: least must be from 0 to 1";
    if (!is_side(size[0]) || !is_side(size[1]))
        return "window: the size of the display must be positive, 1e-9 to 1e9 pixels";
    for (i = 0; i < count && !fault; ++i) fault = gffe_camera_fault(&predicted[i]);
    if (fault) return fault;
    for (i = 0; i < count; ++i) clamped |= cover(current, &predicted[i], options, low, high);
    for (k = 0; k < 2; ++k) {
        const double more = 2 * options->margin / size[k];
        const double rest = 2 * larger(GFFE_AT_REST / size[k], options->least);
        low[k] = -1 - (low[k] < -1 - rest ? low[k] - more : -1.0);
        high[k] = (high[k] > 1 + rest ? high[k] + more : 1.0) - 1;
        clamped |= limit(&low[k], &high[k], 2 * (options->max_enlargement - 1));
    }
    made->u0 = -1 - low[0];
    made->v0 = -1 - low[1];
    made->u1 = 1 + high[0];
    made->v1 = 1 + high[1];
    made->clamped = clamped;
    return NULL;
}

gffe_camera gffe_window_camera(const gffe_window *window, const gffe_camera *display, double width, double height,
                               double render_width, double render_height) {
    double scale_x, scale_y, left, top;
    gffe_camera made;
    const gffe_camera none = {{{0}}, 0, 0, 0, 0};
    if (!window || gffe_camera_fault(display)) return none;
    if (!is_side(width) || !is_side(height) || !is_side(render_width) || !is_side(render_height)) return none;
    if (!(window->u0 < window->u1 && window->v0 < window->v1)) return none;
    scale_x = render_width / (width * ((window->u1 - window->u0) / 2));
    scale_y = render_height / (height * ((window->v1 - window->v0) / 2));
    left = (window->u0 + 1) / 2 * width;
    top = (window->v0 + 1) / 2 * height;
    made = *display;
    made.fx = display->fx * scale_x;
    made.fy = display->fy * scale_y;
    made.cx = (display->cx - left) * scale_x;
    made.cy = (display->cy - top) * scale_y;
    return gffe_camera_fault(&made) ? none : made;
}

static int by_size(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

double gffe_nearest_depth(const float *depth, int width, int height) {
    const double pixels = (double)width * height;
    int stride = (int)sqrt(floor(pixels / GFFE_NEAR_SAMPLES)), x, y;
    size_t count = 0;
    float *some;
    double found = HUGE_VAL;
    if (!depth || width < 1 || height < 1) return 0;
    if (stride < 1) stride = 1;
    some = (float *)malloc(((size_t)(width / stride) + 1) * ((size_t)(height / stride) + 1) * sizeof *some);
    if (!some) return -1;
    for (y = 0; y < height; y += stride)
        for (x = 0; x < width; x += stride) {
            const float z = depth[(size_t)y * width + x];
            if (z > 0 && z <= FLT_MAX) some[count++] = z;
        }
    if (count) {
        qsort(some, count, sizeof *some, by_size);
        found = some[(size_t)((double)count * GFFE_NEAR_QUANTILE)];
    }
    free(some);
    return found;
}
