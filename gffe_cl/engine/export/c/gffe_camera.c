/* Cameras: host arithmetic in float64, without OpenCL.

   Every operation stands in the order in which Python's gffe_cl has it, so that both give the same bits. That holds as
   long as the compiler fuses no multiplications with additions: -ffp-contract=off, which CMakeLists.txt sets. */
#include <float.h>
#include <math.h>

#include "gffe_internal.h"

/* ---- vectors of three (gffe_cl/engine/frame/vectors.py) ------------------------------------------------ */

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

static void cross(const double a[3], const double b[3], double made[3]) {
    made[0] = a[1] * b[2] - a[2] * b[1];
    made[1] = a[2] * b[0] - a[0] * b[2];
    made[2] = a[0] * b[1] - a[1] * b[0];
}

static void times_vector(double matrix[3][3], const double v[3], double made[3]) {
    int i;
    for (i = 0; i < 3; ++i) made[i] = dot(matrix[i], v);
}

static void product(double a[3][3], double b[3][3], double made[3][3]) {
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) made[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
}

static void inverse(double m[3][3], double made[3][3]) {
    double columns[3][3], scale;
    int i, j;
    cross(m[1], m[2], columns[0]);
    cross(m[2], m[0], columns[1]);
    cross(m[0], m[1], columns[2]);
    scale = dot(m[0], columns[0]);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) made[i][j] = columns[j][i] / scale;
}

/* ---- cameras (gffe_cl/engine/frame/camera.py) ---------------------------------------------------------- */

static void rotation_of(const gffe_camera *camera, double made[3][3]) {
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) made[i][j] = camera->world_to_view[i][j];
}

/* Computes rotation and translation of view -> world. */
static void view_inverse(const gffe_camera *camera, double rotation[3][3], double translation[3]) {
    double own[3][3], moved[3];
    int k;
    rotation_of(camera, own);
    inverse(own, rotation);
    for (k = 0; k < 3; ++k) moved[k] = camera->world_to_view[k][3];
    times_vector(rotation, moved, translation);
    for (k = 0; k < 3; ++k) translation[k] = -translation[k];
}

double gffe_distance(const gffe_camera *a, const gffe_camera *b) {
    double rotation[3][3], here[3], there[3];
    int k;
    view_inverse(a, rotation, here);
    view_inverse(b, rotation, there);
    for (k = 0; k < 3; ++k) here[k] = here[k] - there[k];
    return sqrt(dot(here, here));
}

static int same_matrix(const gffe_camera *a, const gffe_camera *b) {
    int i, j;
    for (i = 0; i < 4; ++i)
        for (j = 0; j < 4; ++j)
            if (a->world_to_view[i][j] != b->world_to_view[i][j]) return 0;
    return 1;
}

void gffe_view_transform(const gffe_camera *a, const gffe_camera *b, double made[3][4]) {
    double rotation[3][3], translation[3], other[3][3], turned[3][3], moved[3];
    int i, j;
    if (same_matrix(a, b)) {
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 4; ++j) made[i][j] = i == j;
        return;
    }
    view_inverse(a, rotation, translation);
    rotation_of(b, other);
    times_vector(other, translation, moved);
    product(other, rotation, turned);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) made[i][j] = turned[i][j];
        made[i][3] = moved[i] + b->world_to_view[i][3];
    }
}

static int is_finite(const double *numbers, int count) {
    int k;
    for (k = 0; k < count; ++k)
        if (!(fabs(numbers[k]) <= DBL_MAX)) return 0;
    return 1;
}

const char *gffe_camera_fault(const gffe_camera *camera) {
    double m[3][3];
    int i, j;
    if (!camera) return "camera: there is none (expected a gffe_camera)";
    if (!is_finite(&camera->world_to_view[0][0], 16) || !is_finite(&camera->fx, 1) || !is_finite(&camera->fy, 1)
        || !is_finite(&camera->cx, 1) || !is_finite(&camera->cy, 1))
        return "camera: not finite (world_to_view, fx, fy, cx and cy must be finite numbers)";
    rotation_of(camera, m);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j)
            if (!(fabs(dot(m[i], m[j]) - (i == j)) <= GFFE_RIGIDITY_TOLERANCE))
                return "camera: world_to_view is singular or not rigid (expected a rotation and a translation)";
    for (j = 0; j < 4; ++j)
        if (fabs(camera->world_to_view[3][j] - (j == 3)) > 1e-9)
            return "camera: the last row of world_to_view must be 0 0 0 1 (column vectors)";
    if (camera->fx <= 0 || camera->fy <= 0) return "camera: singular projection, fx and fy must be positive";
    if (camera->fx > GFFE_MOST_FOCAL || camera->fx < 1 / GFFE_MOST_FOCAL || camera->fy > GFFE_MOST_FOCAL
        || camera->fy < 1 / GFFE_MOST_FOCAL)
        return "camera: fx and fy must be within 1e-9 and 1e9 pixels";
    for (i = 0; i < 3; ++i)
        if (fabs(camera->world_to_view[i][3]) > GFFE_MOST_DISTANCE || fabs(camera->cx) > GFFE_MOST_FOCAL
            || fabs(camera->cy) > GFFE_MOST_FOCAL)
            return "camera: cx, cy must be within 1e9 pixels and the position within 1e15 world units";
    return NULL;
}

gffe_camera gffe_scaled(const gffe_camera *camera, double scale_x, double scale_y) {
    gffe_camera made = *camera;
    made.fx = camera->fx * scale_x;
    made.fy = camera->fy * scale_y;
    made.cx = camera->cx * scale_x;
    made.cy = camera->cy * scale_y;
    return made;
}

int gffe_have_one_pose(const gffe_camera *render, const gffe_camera *display) {
    double most = 0;
    int i, j;
    for (i = 0; i < 3; ++i)
        if (fabs(render->world_to_view[i][3]) > most) most = fabs(render->world_to_view[i][3]);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j)
            if (fabs(render->world_to_view[i][j] - display->world_to_view[i][j]) > GFFE_SAME_POSE) return 0;
        if (fabs(render->world_to_view[i][3] - display->world_to_view[i][3]) > GFFE_SAME_POSE * (1 + most)) return 0;
    }
    return 1;
}

int gffe_see_alike(const gffe_camera *a, const gffe_camera *b) {
    return a->fx == b->fx && a->fy == b->fy && a->cx == b->cx && a->cy == b->cy && same_matrix(a, b);
}
