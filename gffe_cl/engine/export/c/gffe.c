/* Order of the stages, and state between frames (gffe_cl/engine/pipeline/pipeline.py). */
#include "gffe.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "gffe_internal.h"

/* ---- options and device ------------------------------------------------------------------------------- */

gffe_options gffe_default_options(int width, int height) {
    gffe_options made;
    memset(&made, 0, sizeof made);
    made.width = width;
    made.height = height;
    made.fps = 30;
    made.int64_atomics = -1;
    return made;
}

static gffe_status decide_cut(gffe *g);

static gffe_status check_options(gffe *g) {
    const gffe_options *options = &g->options;
    const double least = GFFE_LEAST_FRAME_RATE, most = GFFE_MOST_FRAME_RATE;
    gffe_status status = gffe_need_whole(g, "options: width", options->width, 1, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_whole(g, "options: height", options->height, 1, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_whole(g, "options: render_width", options->render_width, 0, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_whole(g, "options: render_height", options->render_height, 0, GFFE_MOST_PIXELS);
    if (!status) status = gffe_need_number(g, "options: fps", options->fps, least, most);
    if (!status) status = gffe_need_whole(g, "options: int64_atomics", options->int64_atomics, -1, 1);
    if (status) return status;
    if (!options->render_width != !options->render_height)
        return gffe_fail(g, GFFE_INVALID,
                         "options: render_width and render_height must be 0 both or neither, got %d and %d",
                         options->render_width, options->render_height);
    if (options->lanes != 0 && options->lanes != 1 && options->lanes != 8)
        return gffe_fail(g, GFFE_INVALID, "options: lanes must be 0, 1 or 8, got %d", options->lanes);
    return GFFE_OK;
}

static gffe_status check_queue(gffe *g, cl_context context, cl_command_queue queue) {
    cl_command_queue_properties properties = 0;
    cl_context its = NULL;
    cl_int error;
    if (!context || !queue) return gffe_fail(g, GFFE_INVALID, "gffe_create: needs a context and a queue, got NULL");
    error = clGetCommandQueueInfo(queue, CL_QUEUE_CONTEXT, sizeof its, &its, NULL);
    if (error == CL_SUCCESS) error = clGetCommandQueueInfo(queue, CL_QUEUE_DEVICE, sizeof g->device, &g->device, NULL);
    if (error == CL_SUCCESS)
        error = clGetCommandQueueInfo(queue, CL_QUEUE_PROPERTIES, sizeof properties, &properties, NULL);
    if (error != CL_SUCCESS) return gffe_checked(g, error, "gffe_create: asking about the queue");
    if (its != context) return gffe_fail(g, GFFE_INVALID, "gffe_create: the queue is of another context");
    if (properties & CL_QUEUE_OUT_OF_ORDER_EXEC_MODE_ENABLE)
        return gffe_fail(g, GFFE_INVALID,
                         "gffe_create: the queue works out of order (expected one that works in order)");
    clRetainContext(context);
    clRetainCommandQueue(queue);
    g->context = context;
    g->queue = queue;
    return GFFE_OK;
}

gffe_status gffe_create(cl_context context, cl_command_queue queue, const gffe_options *options, gffe **made) {
    gffe *g = made ? (gffe *)calloc(1, sizeof *g) : NULL;
    gffe_status status;
    if (!made) return GFFE_INVALID;
    *made = g;
    if (!g) return GFFE_OUT_OF_MEMORY;
    if (!options) return gffe_fail(g, GFFE_INVALID, "gffe_create: needs options (gffe_default_options)");
    g->options = *options;
    g->counts = -1;
    g->exposure = g->step.exposure = 1;
    g->step.target[0] = options->width;
    g->step.target[1] = options->height;
    g->step.source[0] = options->render_width ? options->render_width : options->width;
    g->step.source[1] = options->render_height ? options->render_height : options->height;
    status = check_options(g);
    if (!status) status = check_queue(g, context, queue);
    return status ? status : gffe_open(g);
}

void gffe_destroy(gffe *g) {
    int k;
    if (!g) return;
    if (g->queue) clFinish(g->queue);
    if (g->counted) clReleaseEvent(g->counted);
    for (k = g->memory ? 2 * g->plan->buffer_count - 1 : -1; k >= 0; --k)
        if (g->memory[k]) clReleaseMemObject(g->memory[k]);
    while (g->part_count) clReleaseMemObject(g->parts[--g->part_count]);
    for (k = 0; g->kernels && k < gffe_kernel_count; ++k)
        if (g->kernels[k]) clReleaseKernel(g->kernels[k]);
    for (k = 0; g->programs && k < gffe_program_count; ++k)
        if (g->programs[k]) clReleaseProgram(g->programs[k]);
    for (k = 0; k < GFFE_LAYERS; ++k) gffe_hold(&g->overlays[k], NULL);
    for (k = 0; k < GFFE_CONVERTED; ++k) gffe_hold(&g->converted[k], NULL);
    gffe_hold(&g->no_motion, NULL);
    if (g->queue) clReleaseCommandQueue(g->queue);
    if (g->context) clReleaseContext(g->context);
    free(g->places);
    free(g->memory);
    free(g->parts);
    free(g->kernels);
    free(g->programs);
    free(g);
}

const char *gffe_message(const gffe *g) {
    return g ? g->message : "there is no gffe: NULL was given, or the host has no memory";
}

int gffe_is_cut(gffe *g) { return g && !decide_cut(g) && g->is_cut; }

double gffe_interval(gffe *g) {
    if (!g || !g->is_ready || decide_cut(g)) return 0;
    return g->step.time_count > 1 ? g->step.times[0] - g->step.times[1] : 1.0 / g->options.fps;
}

gffe_status gffe_set_exposure(gffe *g, double exposure) {
    gffe_status status = gffe_need(g, g, "gffe");
    if (!status) status = gffe_need_number(g, "exposure", exposure, GFFE_LEAST_EXPOSURE, GFFE_MOST_EXPOSURE);
    if (!status) g->exposure = exposure;
    return status;
}

/* ---- rendered frames ---------------------------------------------------------------------------------- */

/* Makes a buffer of zeros for a reset without motion. */
static gffe_status need_no_motion(gffe *g) {
    const size_t nbytes = 8 * (size_t)g->step.source[0] * (size_t)g->step.source[1];
    const cl_uchar zero = 0;
    cl_int error = CL_SUCCESS;
    if (g->no_motion) return GFFE_OK;
    g->no_motion = clCreateBuffer(g->context, CL_MEM_READ_WRITE, nbytes, NULL, &error);
    if (g->no_motion) error = clEnqueueFillBuffer(g->queue, g->no_motion, &zero, 1, 0, nbytes, 0, NULL, NULL);
    return gffe_checked(g, error, "a buffer for a frame without motion");
}

static gffe_status check_frame(gffe *g, cl_mem color, cl_mem depth, cl_mem motion, const gffe_camera *camera,
                               const gffe_camera *display, double time, int reset) {
    const char *fault = gffe_camera_fault(camera);
    gffe_status status;
    if (!fault) fault = gffe_camera_fault(display);
    if (fault) return gffe_fail(g, GFFE_INVALID, "frame: %s", fault);
    status = gffe_need_number(g, "frame: time", time, -GFFE_LARGEST, GFFE_LARGEST);
    if (status) return status;
    if (g->step.time_count && !reset && time <= g->step.times[0])
        return gffe_fail(g, GFFE_INVALID, "frame: time %g s must be after the previous rendered frame's (%g s)", time,
                         g->step.times[0]);
    if (!gffe_have_one_pose(camera, display))
        return gffe_fail(
            g, GFFE_INVALID,
            "frame: display_camera must have the pose of the render camera (expected equal world_to_view)");
    if (g->has_format) {
        const cl_mem given[3] = {color, depth, motion};
        status = gffe_check_formatted(g, given);
    } else {
        status = gffe_check_buffer(g, color, "color", GFFE_RENDERED_COLOR);
        if (!status) status = gffe_check_buffer(g, depth, "depth", GFFE_RENDERED_DEPTH);
        if (!status && motion) status = gffe_check_buffer(g, motion, "motion", GFFE_RENDERED_MOTION);
    }
    if (!status && !motion && !reset)
        return gffe_fail(g, GFFE_INVALID, "frame at %g s: motion is missing (only reset frames may lack it)", time);
    return status || motion ? status : need_no_motion(g);
}

/* The frame becomes the current one, and the current one the frame before. */
static void take_frame(gffe *g, cl_mem color, cl_mem depth, cl_mem motion) {
    const cl_mem given[3] = {color, depth, motion};
    int k;
    for (k = 0; k < 3; ++k) {
        gffe_hold(&g->memory[GFFE_PREVIOUS_COLOR + 2 * k], g->memory[2 * k]);
        gffe_hold(&g->memory[2 * k], given[k]);
    }
}

/* Decides by the counts of samples whether the frame is a cut (gffe_cl/engine/stages/measures.py). */
static int is_cut(const cl_int *counts, int jumped) {
    const double valid = counts[GFFE_VALID], inside = counts[GFFE_INSIDE], compared = counts[GFFE_COMPARED];
    double depth;
    if (valid < GFFE_CUT_LEAST_SAMPLES) return 0;
    if (inside < GFFE_CUT_LEAST_OVERLAP * valid || (jumped && counts[GFFE_PASSED] > valid / 2)) return 1;
    if (compared < GFFE_CUT_LEAST_SAMPLES / 4) return 0; /* it is all sky, before and now */
    depth = counts[GFFE_DEPTH_RIGHT] / compared;
    if (counts[GFFE_WITH_CONTRAST] < GFFE_CUT_LEAST_CONTRASTS)
        return depth < (GFFE_CUT_DEPTH_SURE + GFFE_CUT_DEPTH_UNSURE) / 2;
    return depth < GFFE_CUT_DEPTH_SURE
           || (depth < GFFE_CUT_DEPTH_UNSURE
               && counts[GFFE_CONTRAST_RIGHT] / (double)counts[GFFE_WITH_CONTRAST] < GFFE_CUT_CONTRAST_RIGHT);
}

/* Counts samples of the rendered frame, and copies the counts to the host, which does not wait. */
static gffe_status look_for_cut(gffe *g) {
    const int had_step = g->has_step;
    const double before = g->camera_step;
    gffe_status status;
    cl_int error;
    g->has_step = g->is_cut = 0;
    if (!GFFE_CUT_DETECTION || !g->has_previous) return GFFE_OK;
    g->camera_step = gffe_distance(&g->step.cameras[GFFE_FRAME], &g->step.cameras[GFFE_PREVIOUS]);
    g->jumped = had_step && g->camera_step > GFFE_CUT_TELEPORT * before;
    g->has_step = 1;
    status = gffe_run(g, GFFE_CUT);
    if (status) return status;
    error = clEnqueueReadBuffer(g->queue, g->memory[g->counts], CL_FALSE, 0, sizeof g->cut_counts, g->cut_counts, 0,
                                NULL, &g->counted);
    if (error == CL_SUCCESS) error = clFlush(g->queue);
    return gffe_checked(g, error, "reading the samples of a cut");
}

static void forget(gffe *g) {
    g->step.time_count = g->has_previous = g->step.rests = 0;
    g->step.cameras[GFFE_PREVIOUS] = g->step.cameras[GFFE_FRAME];
    g->step.cameras[GFFE_PREVIOUS_DISPLAY] = g->step.cameras[GFFE_FRAME_DISPLAY];
}

/* Stores the time before the known ones since the last reset. */
static void remember(gffe *g, double time) {
    gffe_step *step = &g->step;
    int k;
    if (step->time_count < GFFE_MOST_TIMES) ++step->time_count;
    for (k = step->time_count - 1; k > 0; --k) step->times[k] = step->times[k - 1];
    step->times[0] = time;
}

/* Waits for the counts, decides whether the rendered frame is a cut, and works on it again as on a reset if it is. */
static gffe_status decide_cut(gffe *g) {
    cl_int sums[GFFE_COUNTED] = {0}, error;
    size_t size[2];
    int k, row;
    if (!g->counted) return GFFE_OK;
    error = clWaitForEvents(1, &g->counted);
    clReleaseEvent(g->counted);
    g->counted = NULL;
    if (error != CL_SUCCESS) return gffe_checked(g, error, "waiting for the samples of a cut");
    gffe_grid_size(&g->step, GFFE_CUT_SAMPLES, size);
    for (row = 0; row < (int)size[1]; ++row)
        for (k = 0; k < GFFE_COUNTED; ++k) sums[k] += g->cut_counts[row][k];
    g->is_cut = is_cut(sums, g->jumped);
    if (!g->is_cut) return GFFE_OK;
    g->has_step = 0;
    forget(g);
    remember(g, g->step.times[0]);
    return gffe_run(g, GFFE_RENDERED_FIRST);
}

/* Returns the camera without jitter: a principal point within a pixel of the middle belongs there
   (gffe_cl/engine/frame/window.py). */
static gffe_camera without_jitter(const gffe_camera *camera, const int size[2]) {
    const double x = size[0] / 2.0, y = size[1] / 2.0;
    gffe_camera made = *camera;
    if (fabs(camera->cx - x) <= 1 && fabs(camera->cy - y) <= 1) {
        made.cx = x;
        made.cy = y;
    }
    return made;
}

gffe_status gffe_submit(gffe *g, cl_mem color, cl_mem depth, cl_mem motion, const gffe_camera *camera,
                        const gffe_camera *display_camera, double time, int reset) {
    return gffe_submit_after(g, color, depth, motion, camera, display_camera, time, reset, 0, NULL, NULL);
}

gffe_status gffe_submit_after(gffe *g, cl_mem color, cl_mem depth, cl_mem motion, const gffe_camera *camera,
                              const gffe_camera *display_camera, double time, int reset, cl_uint count,
                              const cl_event *wait_for, cl_event *done) {
    const cl_mem given[3] = {color, depth, motion};
    cl_mem frame[3] = {color, depth, motion};
    gffe_step *step;
    gffe_camera shown;
    gffe_status status = gffe_need(g, camera, "camera");
    if (done) *done = NULL;
    if (status) return status;
    step = &g->step;
    if (!display_camera) {
        shown = *GFFE_RENDERED_PICTURE ? without_jitter(camera, step->source) : *camera;
        if (step->source[0] != step->target[0] || step->source[1] != step->target[1])
            shown = gffe_scaled(camera, (double)step->target[0] / step->source[0],
                                (double)step->target[1] / step->source[1]);
        display_camera = &shown;
    }
    status = check_frame(g, color, depth, motion, camera, display_camera, time, reset);
    if (!status) status = decide_cut(g);
    if (!status) status = gffe_wait_for(g, count, wait_for);
    if (!status && g->has_format) status = gffe_prepare_formatted(g, given, frame);
    if (status) return status;
    take_frame(g, frame[0], frame[1], frame[2] ? frame[2] : g->no_motion);
    step->cameras[GFFE_PREVIOUS] = step->cameras[GFFE_FRAME];
    step->cameras[GFFE_PREVIOUS_DISPLAY] = step->cameras[GFFE_FRAME_DISPLAY];
    step->cameras[GFFE_FRAME] = *camera;
    step->cameras[GFFE_FRAME_DISPLAY] = *display_camera;
    g->has_previous = g->has_frame && !reset;
    g->has_frame = 1;
    step->exposure = g->exposure;
    step->number = step->number % GFFE_MOST_NUMBER + 1;
    if (!gffe_see_alike(&step->cameras[GFFE_PREVIOUS], camera)) {
        step->rests = 0;
    } else if (step->rests < GFFE_MOST_RESTS) {
        ++step->rests;
    }
    step->coded = !step->rests;
    status = gffe_convert(g, given, g->has_previous);
    if (!status) status = gffe_take_overlays(g);
    if (status) return status;
    if (!g->has_previous) forget(g);
    remember(g, time);
    gffe_swap(g, 0);
    status = look_for_cut(g);
    if (!status) status = gffe_run(g, g->has_previous ? GFFE_RENDERED : GFFE_RENDERED_FIRST);
    return status ? status : gffe_mark(g, done);
}

/* ---- extrapolated and presented frames ---------------------------------------------------------------- */

/* Checks that there is a rendered frame, and decides whether it is a cut. */
static gffe_status need_frame(gffe *g, const void *made) {
    const gffe_status status = gffe_need(g, made, "made");
    if (status) return status;
    return g->has_frame ? decide_cut(g) : gffe_fail(g, GFFE_INVALID, "extrapolate: submit a rendered frame first");
}

static cl_mem memory_of(const gffe *g, const char *name) {
    const int reference = gffe_reference(g, name);
    return reference < 0 ? NULL : g->memory[reference];
}

static void hand_out(const gffe *g, gffe_frame *made) {
    made->gae = memory_of(g, "frame.color");
    made->color = memory_of(g, GFFE_EXTRAPOLATED_PICTURE);
    made->depth = memory_of(g, "frame.depth");
    made->motion = memory_of(g, "frame.motion");
    made->dynamic = memory_of(g, "frame.dynamic");
    made->disoccluded = memory_of(g, "frame.disoccluded");
    made->filled_by = memory_of(g, "frame.filled_by");
    made->expected_error = memory_of(g, "shading.expected_error");
    made->camera = g->step.cameras[GFFE_TARGET_CAMERA];
    made->time = g->step.time;
    made->alpha = g->step.alpha;
}

gffe_status gffe_extrapolate(gffe *g, const gffe_camera *camera, double time, gffe_frame *made) {
    return gffe_extrapolate_after(g, camera, time, made, 0, NULL, NULL);
}

gffe_status gffe_extrapolate_after(gffe *g, const gffe_camera *camera, double time, gffe_frame *made, cl_uint count,
                                   const cl_event *wait_for, cl_event *done) {
    gffe_step *step;
    gffe_status status = need_frame(g, made);
    const char *fault;
    double alpha;
    if (done) *done = NULL;
    if (status) return status;
    status = gffe_need_number(g, "extrapolate: time", time, -GFFE_LARGEST, GFFE_LARGEST);
    if (status) return status;
    step = &g->step;
    alpha = (time - step->times[0]) / gffe_interval(g);
    if (!(alpha >= 0))
        return gffe_fail(g, GFFE_INVALID, "extrapolate: time %g s is before the last rendered frame's (%g s)", time,
                         step->times[0]);
    if (!(alpha <= GFFE_MOST_ALPHA))
        return gffe_fail(g, GFFE_INVALID, "extrapolate: time %g s is more than %g intervals after %g s", time,
                         GFFE_MOST_ALPHA, step->times[0]);
    fault = gffe_camera_fault(camera);
    if (fault) return gffe_fail(g, GFFE_INVALID, "extrapolate: %s", fault);
    status = gffe_wait_for(g, count, wait_for);
    if (status) return status;
    step->cameras[GFFE_TARGET_CAMERA] = *camera;
    step->time = time;
    step->alpha = alpha;
    step->stays = gffe_stays(step);
    status = gffe_run(g, g->has_previous ? GFFE_EXTRAPOLATED : GFFE_EXTRAPOLATED_FIRST);
    if (status) return status;
    step->coded |= !step->stays;
    hand_out(g, made);
    status = gffe_compose(g, GFFE_COMPOSE, made);
    return status ? status : gffe_mark(g, done);
}

static int is_shown_whole(const gffe *g, int camera, int display) {
    const gffe_camera *a = &g->step.cameras[camera], *b = &g->step.cameras[display];
    return g->step.source[0] == g->step.target[0] && g->step.source[1] == g->step.target[1] && a->fx == b->fx
           && a->fy == b->fy && a->cx == b->cx && a->cy == b->cy;
}

/* Resamples the rendered frame, with all of its depth, to its display camera. */
static gffe_status resample(gffe *g, gffe_frame *made) {
    const cl_mem depth = g->memory[GFFE_RENDERED_DEPTH];
    gffe_status status = GFFE_OK;
    if (!memory_of(g, "presentation.motion")) status = gffe_allocate(g, GFFE_LATE); /* the last of them */
    if (status) return status;
    g->memory[GFFE_RENDERED_DEPTH] = g->memory[GFFE_SHOWN_DEPTH];
    status = gffe_run(g, g->has_previous ? GFFE_PRESENT : GFFE_PRESENT_FIRST);
    g->memory[GFFE_RENDERED_DEPTH] = depth;
    made->color = memory_of(g, "presentation.color");
    made->depth = memory_of(g, "presentation.depth");
    made->motion = memory_of(g, "presentation.motion");
    return status;
}

gffe_status gffe_present(gffe *g, gffe_frame *made) { return gffe_present_after(g, made, 0, NULL, NULL); }

gffe_status gffe_present_after(gffe *g, gffe_frame *made, cl_uint count, const cl_event *wait_for, cl_event *done) {
    gffe_status status = need_frame(g, made);
    if (done) *done = NULL;
    if (!status) status = gffe_wait_for(g, count, wait_for);
    if (status) return status;
    memset(made, 0, sizeof *made);
    made->camera = g->step.cameras[GFFE_FRAME_DISPLAY];
    made->time = g->step.times[0];
    made->color = g->memory[GFFE_RENDERED_COLOR];
    made->depth = g->memory[GFFE_SHOWN_DEPTH];
    made->motion = g->memory[GFFE_RENDERED_MOTION];
    if (!is_shown_whole(g, GFFE_FRAME, GFFE_FRAME_DISPLAY)
        || (g->has_previous && !is_shown_whole(g, GFFE_PREVIOUS, GFFE_PREVIOUS_DISPLAY)))
        status = resample(g, made);
    if (*GFFE_RENDERED_PICTURE) made->color = memory_of(g, GFFE_RENDERED_PICTURE);
    if (!status) status = gffe_compose(g, GFFE_COMPOSE_RENDERED, made);
    return status ? status : gffe_mark(g, done);
}

gffe_status gffe_get(gffe *g, const char *name, gffe_image *found) {
    gffe_status status = gffe_need(g, name, "name");
    const gffe_buffer *buffer;
    size_t size[2];
    int reference;
    if (!status) status = gffe_need(g, found, "found");
    if (!status) status = decide_cut(g);
    if (status) return status;
    reference = gffe_reference(g, name);
    if (reference < 0 || !g->memory[reference] || g->plan->buffers[reference / 2].flags & GFFE_MEMORY)
        return gffe_fail(g, GFFE_INVALID, "there is no buffer '%.60s' (gffe_buffer_name lists them)", name);
    buffer = &g->plan->buffers[reference / 2];
    gffe_grid_size(&g->step, buffer->grid, size);
    found->memory = g->memory[reference];
    found->width = size[0];
    found->height = size[1];
    found->planes = (size_t)buffer->planes;
    found->bytes_per_pixel = (size_t)buffer->bytes;
    return GFFE_OK;
}

const char *gffe_buffer_name(const gffe *g, int number) {
    return !g || !g->is_ready || number < 0 || number >= g->plan->buffer_count ? NULL : g->plan->buffers[number].name;
}
