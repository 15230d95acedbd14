/* Cameras, their prediction and adaptive windows: host arithmetic in float64. No OpenCL here.

   Every operation stands in the order in which Python's gffe_cl has it, so that both give the same bits. That holds as
   long as the compiler fuses no multiplications with additions: -ffp-contract=off, which CMakeLists.txt sets. */
#ifndef GFFE_CAMERA_H
#define GFFE_CAMERA_H

#ifdef __cplusplus
extern "C" {
#endif

/* A pinhole camera. The axes of the view are x right, y down, z forward; the center of pixel (i, j) is
   (i + 0.5, j + 0.5), the origin the image's top left corner. */
typedef struct gffe_camera {
    double world_to_view[4][4]; /* [row][column], for column vectors; a rotation and a translation, world units */
    double fx, fy;              /* focal lengths, pixels, > 0 */
    double cx, cy;              /* principal point, pixels; jitter is part of it */
} gffe_camera;

/* The rendered area, in coordinates of the displayed image, which is (-1, -1, 1, 1): u to the right, v down. */
typedef struct gffe_window {
    double u0, v0, u1, v1;
    int clamped; /* 1: a predicted frustum does not fit, because of the maximum enlargement, or because a corner of it
                    points behind the virtual plane */
} gffe_window;

typedef struct gffe_window_options {
    double width, height;   /* of the displayed image, pixels */
    double max_enlargement; /* of the window's sides, in those of the display, >= 1 */
    double distance;        /* of the virtual plane before the camera, world units; nearer content may leave holes */
    double margin;          /* pixels added beyond sides that are enlarged */
    double least;           /* share of the display's side: a smaller demand leaves the side unchanged */
} gffe_window_options;

/* Returns the fault of a camera, in one line; NULL if it is valid. */
const char *gffe_camera_fault(const gffe_camera *camera);

/* Returns a window's defaults: 1.5 times the display at most, an infinite distance, a margin of 1 pixel. */
gffe_window_options gffe_default_window_options(double width, double height);

/* Makes the window through which to render the frame of `current` so that it covers all of `count` predicted cameras,
   all in pixels of the display and without jitter. Returns NULL, or the error if there is one. */
const char *gffe_adaptive_window(const gffe_camera *current, const gffe_camera *predicted, int count,
                                 const gffe_window_options *options, gffe_window *made);

/* Returns the off-center pinhole to render through, in pixels of an image of `render_width` x `render_height`;
   `display` is in pixels of one of `width` x `height`. Zeros, which no call takes for a camera, where a size is not
   positive, the window is empty, or a camera is invalid. */
gffe_camera gffe_window_camera(const gffe_window *window, const gffe_camera *display, double width, double height,
                               double render_width, double render_height);

/* Returns a `distance` for windows: the lower 5% quantile of a depth image, world units; infinite without any depth.
   Negative if there is no memory for it, 0 without an image: no window takes these. */
double gffe_nearest_depth(const float *depth, int width, int height);

/* Predicts the camera at `time` from the last `count` >= 1 rendered frames, newest first, with their times in seconds;
   `order` 1 (linear), 2 (with the lasting change of velocity) or 0 (automatic: 2 with a correction learned from the
   frames before). Returns NULL, or the error if there is one. */
const char *gffe_predict_camera_at(double time, const gffe_camera *cameras, const double *times, int count, int order,
                                   gffe_camera *made);

/* ---- used by the pipeline ------------------------------------------------------------------------------ */

/* Computes the world position of a camera. */
void gffe_position(const gffe_camera *camera, double position[3]);

double gffe_length(const double v[3]);

/* Computes the transform from the view space of `source` to that of `target`: rows of a 3x4 matrix. */
void gffe_view_transform(const gffe_camera *source, const gffe_camera *target, double made[3][4]);

/* Computes the reprojection for kernels: source view space -> target view space, three rows; both projections, and the
   source's inverse. */
void gffe_reprojection(const gffe_camera *source, const gffe_camera *target, float made[24]);

/* Returns whether both cameras show everything at the same pixels, to the bit. */
int gffe_see_alike(const gffe_camera *a, const gffe_camera *b);

/* Computes the target pixels per source pixel of points equally far from both cameras. */
void gffe_zoom(const gffe_camera *source, const gffe_camera *target, float made[2]);

/* Computes scale x, scale y, offset x, offset y from pixels of `a` to pixels of `b`, which have one pose. */
void gffe_mapping(const gffe_camera *a, const gffe_camera *b, float made[4]);

/* Returns the same camera for an image whose sides are `scale_x`, `scale_y` times as many pixels. */
gffe_camera gffe_scaled(const gffe_camera *camera, double scale_x, double scale_y);

/* Returns whether both have one pose, as a render camera and a display camera must. */
int gffe_have_one_pose(const gffe_camera *render, const gffe_camera *display);

#ifdef __cplusplus
}
#endif
#endif
