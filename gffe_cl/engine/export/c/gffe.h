/* Frame extrapolation for engines: makes the frames after the ones that your renderer has finished.

   C99 and OpenCL 1.2, no other dependency. Coordinates and layouts are those of gffe-cl:
   - images are row-major, origin top left, y down; render images may differ in size from the display
   - color: half x 4 per pixel, linear scene-referred RGB (the fourth is not read)
   - depth: float, planar view-space z, world units, +inf for sky
   - motion: float x 2, pixels: (position in the previous rendered frame) - (position here)
   gffe_set_format takes buffers of other formats and conventions. One gffe serves one
     in-order queue; calls on one gffe come from one thread at a time. NULL where a pointer is needed, and a gffe
     that gffe_create failed to make: functions that return a gffe_status return GFFE_INVALID, others do nothing and
     return NULL or zeros. Which pointers may be NULL stands at each function. Numbers that are not finite or out of
     range are refused, as Python refuses them. Flags are C's: 0 is no, everything else yes. */
#ifndef GFFE_H
#define GFFE_H

#ifndef CL_TARGET_OPENCL_VERSION
#define CL_TARGET_OPENCL_VERSION 120
#endif
#ifdef __APPLE__
#include <OpenCL/opencl.h>
#else
#include <CL/cl.h>
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef struct gffe gffe;

/* A pinhole camera. The axes of the view are x right, y down, z forward; the center of pixel (i, j) is
   (i + 0.5, j + 0.5), the origin the image's top left corner. */
typedef struct gffe_camera {
    double world_to_view[4][4]; /* [row][column], for column vectors; a rotation and a translation, world units */
    double fx, fy;              /* focal lengths, pixels, > 0 */
    double cx, cy;              /* principal point, pixels; jitter is part of it */
} gffe_camera;

/* Returns the fault of a camera, in one line; NULL if it is valid. */
const char *gffe_camera_fault(const gffe_camera *camera);

typedef enum gffe_status {
    GFFE_OK = 0,
    GFFE_INVALID = 1,       /* an argument is invalid; nothing was changed */
    GFFE_OPENCL = 2,        /* a call of OpenCL failed: results are lost, destroy the gffe and create another */
    GFFE_OUT_OF_MEMORY = 3  /* no memory is left on host or device: as after GFFE_OPENCL */
} gffe_status;

typedef struct gffe_options {
    int width, height;               /* of the display, and so of extrapolated frames, pixels */
    int render_width, render_height; /* of rendered frames; both 0: as the display */
    double fps;                      /* rendered frames per second, 1e-6 to 1e6, until two of them are known */
    int lanes;                       /* pixels per work-item: 1, 8, or 0: as suits the device */
    int int64_atomics; /* 0, 1, or -1: if the device has them, which is tried; the results are the same */
    int float_sums;    /* whether the network sums in floats, for devices that are slow at integers; the results are
                          the same */
} gffe_options;

/* A result on the device: buffers that hold it until the next one is made. `motion` points into the rendered frame.
   Presented frames have color, depth and motion only; the others are NULL. */
typedef struct gffe_frame {
    cl_mem color, depth, motion; /* half x 4, float, float x 2 */
    cl_mem dynamic, disoccluded, filled_by; /* uchar */
    cl_mem gae; /* color before shading correction, half x 4 */
    cl_mem expected_error; /* uchar; NULL without this option */
    gffe_camera camera; /* in pixels of the display */
    double time, alpha; /* seconds; intervals after the rendered frame */
} gffe_frame;

/* A named buffer, "history.dynamic_mask". */
typedef struct gffe_image {
    cl_mem memory;
    size_t width, height, planes, bytes_per_pixel;
} gffe_image;

/* Returns options for a display of this size, with recommended values for everything else. */
gffe_options gffe_default_options(int width, int height);

/* Builds the kernels and allocates all buffers; nothing is built or allocated later but with the first frame that is
   rendered through a window, comes without motion, or brings overlays. `queue` must work in order. Destroy *made
   whatever is returned; it is NULL only where the host has no memory, and nothing is made where `made` is NULL. After a
   failure use it for gffe_message only. */
gffe_status gffe_create(cl_context context, cl_command_queue queue, const gffe_options *options, gffe **made);

/* Waits for the queue, and frees everything. NULL is allowed. */
void gffe_destroy(gffe *g);

/* Returns the last failure: one line, and the compiler's log if kernels do not build. */
const char *gffe_message(const gffe *g);

/* Takes a rendered frame; frames must come in order of time (seconds). The buffers are used in place: do not overwrite
   them before two more frames have been submitted. `camera` is the render camera, in render pixels. `display_camera` is
   the camera of the displayed image, in display pixels, of the same pose (NULL: the same frustum). `reset`: nothing
   before this frame may be used (a cut); then motion may be NULL. Returns at once. */
gffe_status gffe_submit(gffe *g, cl_mem color, cl_mem depth, cl_mem motion, const gffe_camera *camera,
                        const gffe_camera *display_camera, double time, int reset);

/* Does the same as gffe_submit with events, in the form of OpenCL's own calls: no work begins before all `count` events
   of `wait_for` are complete (0 and NULL: none). *done (unless `done` is NULL) becomes an event that is complete when
   the work on the frame is; release it. The events must be of the queue's context. The queue has been flushed then, so
   that other queues can wait for *done. Where this fails there is no event. Events that have failed already are
   refused. */
gffe_status gffe_submit_after(gffe *g, cl_mem color, cl_mem depth, cl_mem motion, const gffe_camera *camera,
                              const gffe_camera *display_camera, double time, int reset, cl_uint count,
                              const cl_event *wait_for, cl_event *done);

/* Types of values. Integers stand for 0 to 1, or -1 to 1 (GFFE_SNORM16). GFFE_UNORM24 are the low 24 bits of 32. */
typedef enum gffe_type {
    GFFE_FLOAT32 = 1,
    GFFE_FLOAT16,
    GFFE_UNORM8,
    GFFE_UNORM16,
    GFFE_SNORM16,
    GFFE_UNORM24
} gffe_type;

/* Depth: planar depth; the value of a depth buffer, in which 1/z is linear; log(z / near_z) / log(far_z / near_z), with
   near_z 0 log(1 + z) / log(1 + far_z); the distance along the ray. */
enum { GFFE_LINEAR, GFFE_DEVICE, GFFE_LOGARITHMIC, GFFE_DISTANCE };

/* Units of motion: pixels of the motion image, 0 to 1 across the image, -1 to 1 across it, or pixels of the color
   image. */
enum { GFFE_PIXELS, GFFE_UV, GFFE_NDC, GFFE_COLOR_PIXELS };

/* What motion vectors have of the camera's motion: all of it; all of it, but only movers have vectors, and the camera's
   own motion is taken where both components hold `motion_invalid`; nothing, it is added. */
enum { GFFE_CAMERA_INCLUDED, GFFE_CAMERA_MOVERS_ONLY, GFFE_CAMERA_EXCLUDED };

/* Describes buffers of rendered frames in an engine's own formats. Color has the render size; depth and motion have it,
   too, or are up to three times smaller, each way, by another size in every frame. */
typedef struct gffe_format {
    int geometry_width, geometry_height; /* of depth and motion, pixels; both 0: as color */
    int rows_up; /* whether the first rows of all three buffers are the lowest ones */
    int color_type, color_channels; /* float16, float32, unorm16 or unorm8; 3 or 4 channels */
    int color_srgb; /* whether color is sRGB instead of linear */
    int depth_type; /* float32, unorm16 or unorm24 */
    int depth; /* GFFE_LINEAR ... */
    double depth_scale; /* factor to world units of linear depth and distances; 1 of others */
    double near_z, far_z, depth_range[2]; /* planar depth where the buffer holds the first and the second value of the
                                             range; of device depth greater than 0, one of them perhaps infinite */
    int motion_type, motion_channels; /* float32, float16, unorm16 or snorm16; 2 to 4 channels */
    double motion_scale[2], motion_offset[2]; /* stored value * scale + offset is motion in its unit */
    int motion_unit;
    int motion_from_previous; /* whether it is (here - previous) */
    int motion_y_up; /* whether positive y is up */
    int motion_dilated; /* whether pixels hold the vector of the nearest of the 3x3 pixels around, which is undone */
    int motion_jittered; /* whether vectors include the jitter of gffe_set_geometry_jitter, which is then removed */
    double motion_invalid; /* the stored value that both components have where no vector was written; NAN: none */
    int camera_motion;
} gffe_format;

/* Returns the description of the conventions above. */
gffe_format gffe_default_format(void);

/* Sets the description of the next submitted frames; NULL: they have the conventions above. They are converted on the
   device. Buffers that need that may be overwritten when the event of their gffe_submit_after is complete. */
gffe_status gffe_set_format(gffe *g, const gffe_format *format);

/* Sets the jitter that depth and motion of the next submitted frame have and its color does not: pixels of these to
   the right and down. */
gffe_status gffe_set_geometry_jitter(gffe *g, double x, double y);

/* Layers over the picture of the next submitted frame, which are not warped with it. Each may be NULL, and NULL in
   place of all drops them. Colors are premultiplied: layer + (1 - alpha) * picture. The buffers are in use until the
   frame after that is submitted. */
typedef struct gffe_overlays {
    cl_mem fixed_mask; /* uchar, rendered image: 1 where the picture stays in its place: weapons, cockpits */
    cl_mem effects; /* half x 4, rendered image: effects without depth, such as smoke; not in the frame's own color */
    cl_mem effects_motion; /* float x 2, rendered image: motion of the effects; NULL: they stay in place */
    cl_mem ui; /* half x 4, display: the user interface; not in the frame's own color */
} gffe_overlays;

gffe_status gffe_set_overlays(gffe *g, const gffe_overlays *overlays);

/* Returns whether the last submitted frame was detected as an unmarked cut and so is treated as a reset. This call, and
   the next one that makes a frame, wait until the samples of the frame are counted, which is the first work on it. */
int gffe_is_cut(gffe *g);

/* Returns the seconds between the last two rendered frames; 1/fps after a reset. */
double gffe_interval(gffe *g);

/* Sets the factor on color before display, 1e-6 to 1e6, for the network; 1 until it is set. Call it before gffe_submit:
   the frame keeps it, and so do new frames made from it. */
gffe_status gffe_set_exposure(gffe *g, double exposure);

/* Makes the frame at `time`, seconds, seen by `camera`, in display pixels: the one that you will show the next frame
   through, as well as you know it. Returns at once. */
gffe_status gffe_extrapolate(gffe *g, const gffe_camera *camera, double time, gffe_frame *made);

/* Does the same as gffe_extrapolate with events, as in gffe_submit_after. Wait for readers of the last frame made on
   other queues; *done is complete when the buffers of *made hold the frame. */
gffe_status gffe_extrapolate_after(gffe *g, const gffe_camera *camera, double time, gffe_frame *made, cl_uint count,
                                   const cl_event *wait_for, cl_event *done);

/* Gives the displayed part of the last rendered frame: resampled if it was rendered through a window, else its own
   buffers. */
gffe_status gffe_present(gffe *g, gffe_frame *made);
gffe_status gffe_present_after(gffe *g, gffe_frame *made, cl_uint count, const cl_event *wait_for, cl_event *done);

/* Finds a buffer by the name in gffe-cl's documentation of the stages; an apostrophe means the copy of the frame
   before. Its layout is that of the kernels: colors of background levels as RGB9E5, places in them as offsets, planar
   images one channel after another. Valid until the next frame is submitted. */
gffe_status gffe_get(gffe *g, const char *name, gffe_image *found);

/* Returns the name of buffer 0, 1 ...; NULL after the last one. */
const char *gffe_buffer_name(const gffe *g, int number);

/* ---- pacing: which frame to show when; no call here uses OpenCL or a gffe ------------------------------ */

/* Frame to show at a refresh. */
typedef struct gffe_paced {
    double refresh; /* when it is, seconds of your clock */
    double time; /* of the frame, on the renderer's clock, for gffe_extrapolate */
    double alpha; /* the same in intervals from the last rendered frame on, 0 for that one itself */
    int held; /* whether to keep showing the present frame, whose time and alpha these are */
} gffe_paced;

/* Counts since the beginning: refreshes that were planned; of these shown as rendered, extrapolated or held; frames
   that were ready too late for their refresh; rendered frames that a newer one overtook before their turn; and the
   standard deviation of recent steps of time from refresh to refresh, ms. */
typedef struct gffe_pacing {
    int rendered, extrapolated, held, late, dropped;
    double jitter;
} gffe_pacing;

/* A pacer: yours to store, its members are not yours to use. It may be copied. */
typedef struct gffe_pacer {
    double period, most_alpha, fps, now, began, shown;
    double times[3], delays[30], making[8], steps[120]; /* newest first */
    int times_count, delays_count, making_count, steps_count, is_variable, is_new, has_last;
    gffe_paced last;
    gffe_pacing counts;
} gffe_pacer;

/* Begins pacing for a display of `display_rate` refreshes per second, 1e-6 to 1e6; of a variable one (VRR) the most
   that it can do. `most_alpha`: the largest extrapolation, 1e-6 to 16 intervals, 2 is usual. `fps`: rendered frames per
   second, used until two are known. Numbers out of range are GFFE_INVALID. The decisions are those of Python's Pacer.
 */
gffe_status gffe_pacer_start(gffe_pacer *pacer, double display_rate, double most_alpha, double fps, int is_variable);

/* Notes that a rendered frame of this `time`, on the renderer's clock, is here. After a reset its time may be any, else
   a time that is not after the last one is GFFE_INVALID. */
gffe_status gffe_pacer_rendered(gffe_pacer *pacer, double time, int reset);

/* Plans the frame for the next refresh for which one can be ready. `now`, seconds of a clock that only goes forward,
   which may be another than the renderer's: a time before the last call's is GFFE_INVALID, and so is a plan before the
   first rendered frame. Refreshes of a steady display are counted from the first plan's `now`. */
gffe_status gffe_pacer_plan(gffe_pacer *pacer, double now, gffe_paced *plan);

/* Notes that the frame planned last is ready: made and passed to the display. */
gffe_status gffe_pacer_ready(gffe_pacer *pacer, double now);

gffe_pacing gffe_pacer_statistics(const gffe_pacer *pacer);

#ifdef __cplusplus
}
#endif
#endif
