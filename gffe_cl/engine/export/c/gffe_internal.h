/* Interface between gffe_tables.c, which is generated, and its users. */
#ifndef GFFE_INTERNAL_H
#define GFFE_INTERNAL_H

#include "gffe.h"
#include "gffe_config.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum { GFFE_COLOR, GFFE_DEPTH, GFFE_MOTION, GFFE_BUFFERS, GFFE_CONVERTED = 5, GFFE_LAYERS = 4 }; /* of an engine */

enum { GFFE_FRAME, GFFE_PREVIOUS, GFFE_TARGET_CAMERA, GFFE_FRAME_DISPLAY, GFFE_PREVIOUS_DISPLAY, GFFE_CAMERAS };

/* Kinds of arguments, with two numbers a and b. */
enum {
    GFFE_BUFFER,         /* reference a */
    GFFE_CONSTANT,       /* words from a on, b bytes */
    GFFE_FRAME_BLOCK     /* sizes, cameras, times and options */
};

enum { GFFE_LAUNCH, GFFE_FILL, GFFE_COPY };

enum { GFFE_LANES = -1 }; /* a step that the device decides */
enum {
    GFFE_TAKES_LANES = 1,
    GFFE_TAKES_EXACT_DIVISION = 2,
    GFFE_TAKES_INT64 = 4,
    GFFE_TAKES_FLOAT_SUMS = 8,
    GFFE_OF_FORMATS = 256
};
/* Flags of buffers: the one of the frame before is kept, too; made with the first windowed frame; the caller's; memory
   that contains others side by side; memory that is free while frames are extrapolated; the copy of the frame before is
   free then; made with the first overlays. What the first format needs, GFFE_OF_FORMATS, is a flag of programs, too. */
enum {
    GFFE_KEPT = 1,
    GFFE_LATE = 4,
    GFFE_GIVEN = 8,
    GFFE_MEMORY = 16,
    GFFE_LENT = 32,
    GFFE_LENT_BEFORE = 64,
    GFFE_OF_OVERLAYS = 128
};

/* Grid of buffers or launches: `Layout` of gffe_cl/engine/stages/buffers.py. */
typedef struct gffe_grid {
    int is_of_source;
    size_t texel[2], multiple;
    int is_flat;
    size_t columns, most[2], more[2];
    int levels;
} gffe_grid;

typedef struct gffe_program {
    const char *name;
    const char *const *lines;
    int line_count, flags;
} gffe_program;

/* Kernel that shows a capability of devices: what it makes of two numbers all of whose bits are set. */
typedef struct gffe_trial {
    const char *name;
    const char *const *lines;
    int line_count;
    size_t items;
    cl_ulong expected[2];
} gffe_trial;

typedef struct gffe_kernel {
    int program;
    const char *name;
    int step_x, step_y; /* pixels per work-item */
    int group;          /* work-items, in a row; 0: as suits the device */
    int group_rows;     /* rows of them in a work-group */
    int below;          /* a grid of which more rows below have a work-item per texel; -1 */
} gffe_kernel;

typedef struct gffe_buffer {
    const char *name;
    int grid, level, bytes, planes; /* bytes of a texel */
    int border, byte;               /* pixels stored around each plane; what all bytes are at first */
    int whole;                      /* the buffer of all levels, or the memory, in which it lies; -1 */
    int flags;
    int first, last; /* where it holds nothing but within an extrapolation: the stages that use it; else -1 */
} gffe_buffer;

/* Place of a buffer. */
typedef struct gffe_place {
    int root;     /* the reference of the buffer in which it lies; -1: its own */
    size_t start; /* bytes */
    size_t bytes;
} gffe_place;

typedef struct gffe_argument {
    int kind, a, b;
} gffe_argument;

typedef struct gffe_operation {
    int kind, kernel;
    int grid;     /* of its work-items, before a kernel's step, or of the texels that are filled */
    int repeats;     /* how often the grid is repeated, in a third dimension */
    int first;    /* of its arguments */
    int buffer;   /* reference: twice a buffer's number, plus 1 for its copy of the frame before */
    int other;    /* the reference that is copied, or the byte that fills */
} gffe_operation;

typedef struct gffe_initial {
    int buffer, words, bytes; /* initial content of a buffer: constants */
} gffe_initial;

typedef struct gffe_operations {
    const gffe_operation *list;
    int count;
} gffe_operations;

typedef struct gffe_plan {
    const gffe_buffer *buffers;
    int buffer_count;
    const gffe_argument *arguments;
    const gffe_initial *initial;
    int initial_count;
    gffe_operations operations[GFFE_OCCASIONS];
} gffe_plan;

/* Fields of gffe_format, as FrameFormat describes them (gffe_cl/engine/frame/frame_format.py). */
enum { GFFE_FLAG, GFFE_WHOLE, GFFE_REAL, GFFE_PLANE, GFFE_OPTIONAL }; /* from GFFE_REAL on a double, else an int */
enum { GFFE_OF_COLOR = 1, GFFE_OF_GEOMETRY = 2 };

typedef struct gffe_field {
    const char *name;
    size_t at;       /* bytes from the beginning of a format */
    int kind;
    double usual;    /* by default */
    int least, most; /* of a whole number */
    int types;       /* allowed ones, one bit each; 0: the field is no type */
    int buffers;     /* what it describes: GFFE_OF_COLOR ... */
} gffe_field;

extern const gffe_field gffe_fields[];
extern const int gffe_field_count;
extern const double gffe_type_most[]; /* by type: the stored number that stands for 1, and bytes */
extern const size_t gffe_type_bytes[];
extern const gffe_grid gffe_grids[];
extern const gffe_program gffe_programs[];
extern const int gffe_program_count;
extern const gffe_kernel gffe_kernels[];
extern const int gffe_kernel_count;
extern const cl_uint gffe_constants[];
extern const cl_uint gffe_facts[]; /* a frame block with the values that are the same for all frames */
extern const gffe_plan gffe_plans[2]; /* without and with 64-bit atomics */
extern const gffe_trial gffe_int64_atomics, gffe_exact_division;

/* The current work, and the host's values for it. */
typedef struct gffe_step {
    gffe_camera cameras[GFFE_CAMERAS];
    int source[2], target[2];       /* width, height */
    double times[GFFE_MOST_TIMES];  /* of rendered frames since the last reset, newest first */
    int time_count;
    int number;                     /* of the rendered frame */
    int rests;                      /* intervals for which its camera has been the same */
    int coded;                      /* whether all of its colors are encoded */
    int stays;                      /* whether blocks at rest stay where they are in the new frame */
    double time, alpha, exposure;
    int has[4];                     /* overlays */
    gffe_format format;             /* of the engine's buffers, for a frame that `converts` */
    int converts, converts_after;   /* whether they are, and there is a frame before */
    int has_motion;                 /* whether the frame brings any */
    double jitter[2], previous_jitter[2]; /* of the geometry, pixels of color */
    size_t alignment;               /* of parts of buffers, bytes or texels */
} gffe_step;

struct gffe {
    gffe_options options;
    const gffe_plan *plan;
    cl_context context;
    cl_command_queue queue;
    cl_device_id device;
    int lanes, exact_division;
    cl_program *programs;
    cl_kernel *kernels;
    cl_mem *memory; /* by reference */
    cl_mem *parts;  /* of buffers, in the order in which they were made */
    int part_count;
    gffe_place *places;
    cl_mem no_motion;
    cl_mem overlays[GFFE_LAYERS]; /* of the next frame */
    int has_format, converts[2]; /* color; depth and motion */
    double jitter[2]; /* of the next frame's geometry, pixels of this */
    double exposure;  /* of the next frame */
    cl_mem converted[GFFE_CONVERTED]; /* color and depth of two frames in turn, and one motion */
    int turn;
    int counts;     /* of a cut: the buffer's reference, or -1 */
    gffe_step step;
    int is_ready; /* created well */
    int has_frame, has_previous, is_cut;
    int has_step, jumped; /* whether `camera_step` counts, and is far longer than the one before */
    double camera_step;
    cl_event counted; /* complete when `cut_counts` are there; NULL: nothing is to be decided */
    cl_int cut_counts[GFFE_CUT_SAMPLES_Y][GFFE_COUNTED];
    char message[4096];
};

/* gffe_camera.c */
/* Returns the distance between two cameras, world units. */
double gffe_distance(const gffe_camera *a, const gffe_camera *b);
/* Computes the transform from the view space of `a` to that of `b`: rows of a 3x4 matrix, exactly the identity for
   equal poses. */
void gffe_view_transform(const gffe_camera *a, const gffe_camera *b, double made[3][4]);
/* Returns whether both cameras show everything at the same pixels, to the bit. */
int gffe_see_alike(const gffe_camera *a, const gffe_camera *b);
/* Returns the same camera for an image whose sides are `scale_x`, `scale_y` times as many pixels. */
gffe_camera gffe_scaled(const gffe_camera *camera, double scale_x, double scale_y);
/* Returns whether both have one pose, as a render camera and a display camera must. */
int gffe_have_one_pose(const gffe_camera *render, const gffe_camera *display);

/* gffe_values.c */
cl_float4 gffe_floats(double x, double y, double z, double w);
void gffe_grid_size(const gffe_step *step, int number, size_t size[2]);
size_t gffe_aligned(const gffe_step *step, size_t n);
size_t gffe_level_start(const gffe_step *step, int level);
size_t gffe_buffer_bytes(const gffe_step *step, const gffe_buffer *buffer); /* 0: images of these sizes have none */
void gffe_geometry_of(const gffe_format *format, const int source[2], int size[2]);
int gffe_is_small(const gffe_step *step);
/* Returns whether blocks at rest stay where they are for the new camera (`Pipeline._rest_of`). */
int gffe_stays(const gffe_step *step);
/* Fills the block of the rendered frame or, if `is_new`, of the new one. */
void gffe_fill_frame_block(const gffe_step *step, int is_new, gffe_frame_block *block);

/* gffe_memory.c */
gffe_status gffe_allocate(gffe *g, int late); /* 0, GFFE_LATE, GFFE_OF_OVERLAYS or GFFE_OF_FORMATS: those buffers */
gffe_status gffe_check_bytes(gffe *g, cl_mem buffer, const char *name, const int size[2], size_t texel);
gffe_status gffe_check_buffer(gffe *g, cl_mem buffer, const char *name, int reference);
int gffe_reference(const gffe *g, const char *name); /* -1: there is none */
void gffe_swap(gffe *g, int overlays); /* 0 or GFFE_OF_OVERLAYS: those buffers */

/* gffe_format.c */
gffe_status gffe_check_formatted(gffe *g, const cl_mem buffers[3]);
/* Gives the buffers of the frame for the stages, converted ones where that is needed. */
gffe_status gffe_prepare_formatted(gffe *g, const cl_mem given[3], cl_mem frame[3]);
/* Converts the given buffers into the rendered frame's, whose cameras are set. */
gffe_status gffe_convert(gffe *g, const cl_mem given[3], int has_previous);

/* gffe_overlays.c */
void gffe_hold(cl_mem *place, cl_mem buffer); /* retains it, and releases what was there */
gffe_status gffe_take_overlays(gffe *g);
gffe_status gffe_compose(gffe *g, int occasion, gffe_frame *made);

/* gffe_errors.c */
/* Returns GFFE_INVALID unless `g` was created without error and `argument`, of that name, is not NULL. */
gffe_status gffe_need(gffe *g, const void *argument, const char *name);
/* Return GFFE_INVALID unless the value of that name is a number below GFFE_LARGEST, from `low` to `high`. */
gffe_status gffe_need_number(gffe *g, const char *name, double value, double low, double high);
gffe_status gffe_need_whole(gffe *g, const char *name, int value, int low, int high);
gffe_status gffe_fail(gffe *g, gffe_status status, const char *format, ...);
/* Returns what an error of OpenCL means. */
gffe_status gffe_checked(gffe *g, cl_int error, const char *doing);

/* gffe_device.c */
gffe_status gffe_open(gffe *g);
gffe_status gffe_open_late(gffe *g); /* what formats need */
/* Makes work that is enqueued later wait for the events. Returns GFFE_INVALID for others than the context's. */
gffe_status gffe_wait_for(gffe *g, cl_uint count, const cl_event *events);
/* Makes an event, unless `done` is NULL, that is complete when all work enqueued so far is. */
gffe_status gffe_mark(gffe *g, cl_event *done);
gffe_status gffe_run(gffe *g, int occasion);

#ifdef __cplusplus
}
#endif
#endif
