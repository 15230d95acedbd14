/* Overlays, which are not warped with the picture (gffe_cl/engine/stages/presentation.py). */
#include <string.h>

#include "gffe_internal.h"

static const char *const NAMES[GFFE_LAYERS] = {"fixed_mask", "effects", "effects_motion", "ui"};

void gffe_hold(cl_mem *place, cl_mem buffer) {
    if (buffer) clRetainMemObject(buffer);
    if (*place) clReleaseMemObject(*place);
    *place = buffer;
}

gffe_status gffe_set_overlays(gffe *g, const gffe_overlays *overlays) {
    cl_mem given[GFFE_LAYERS] = {NULL, NULL, NULL, NULL};
    gffe_status status = gffe_need(g, g, "gffe");
    int k;
    if (status) return status;
    if (overlays) {
        given[0] = overlays->fixed_mask;
        given[1] = overlays->effects;
        given[2] = overlays->effects_motion;
        given[3] = overlays->ui;
    }
    if (given[2] && !given[1])
        return gffe_fail(g, GFFE_INVALID, "frame: effects_motion without effects (expected both, or effects alone)");
    for (k = 0; k < GFFE_LAYERS && !status; ++k)
        if (given[k]) status = gffe_check_buffer(g, given[k], NAMES[k], GFFE_OVERLAYS_FIXED_MASK + 2 * k);
    for (k = 0; k < GFFE_LAYERS && !status; ++k) gffe_hold(&g->overlays[k], given[k]);
    return status;
}

static int has_overlays(const gffe *g) {
    int k, any = 0;
    for (k = 0; k < GFFE_LAYERS; ++k) any = any || g->step.has[k];
    return any;
}

gffe_status gffe_take_overlays(gffe *g) {
    const int own = gffe_reference(g, "composition.depth");
    gffe_status status = GFFE_OK;
    int k;
    for (k = 0; k < GFFE_LAYERS; ++k) {
        gffe_hold(&g->memory[GFFE_OVERLAYS_FIXED_MASK + 2 * k], g->overlays[k]);
        g->step.has[k] = g->overlays[k] != NULL;
        gffe_hold(&g->overlays[k], NULL);
    }
    gffe_hold(&g->memory[GFFE_SHOWN_DEPTH], g->memory[GFFE_RENDERED_DEPTH]);
    if (has_overlays(g) && !g->memory[own]) status = gffe_allocate(g, GFFE_OF_OVERLAYS);
    if (status || !g->memory[own]) return status;
    gffe_swap(g, GFFE_OF_OVERLAYS);
    if (!g->step.has[0]) return GFFE_OK;
    status = gffe_run(g, GFFE_LEAVE_OUT);
    gffe_hold(&g->memory[GFFE_RENDERED_DEPTH], g->memory[own]);
    return status;
}

gffe_status gffe_compose(gffe *g, int occasion, gffe_frame *made) {
    gffe_status status;
    if (!has_overlays(g)) return GFFE_OK;
    g->memory[GFFE_SHOWN_COLOR] = made->color;
    status = gffe_run(g, occasion);
    g->memory[GFFE_SHOWN_COLOR] = NULL;
    made->color = g->memory[gffe_reference(g, "composition.color")];
    return status;
}
