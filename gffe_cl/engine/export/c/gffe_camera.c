#include "gffe_camera.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#include "gffe_config.h"

#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* ---- vectors of three (gffe_cl/engine/frame/vectors.py)
   ------------------------------------------------------------ */

static double dot(const double a[3], const double b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

double gffe_length(const double v[3]) { return v ? sqrt(dot(v, v)) : 0; }

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

static double determinant(double m[3][3]) {
    double crossed[3];
    cross(m[1], m[2], crossed);
    return dot(m[0], crossed);
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

static int normalized(const double v[3], double made[3]) {
    const double size = gffe_length(v);
    int k;
    if (!(size <= DBL_MAX) || size < 1e-12) return 0;
    for (k = 0; k < 3; ++k) made[k] = v[k] / size;
    return 1;
}

/* ---- cameras (gffe_cl/engine/frame/camera.py)
   ---------------------------------------------------------------------- */

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

void gffe_position(const gffe_camera *camera, double position[3]) {
    double rotation[3][3];
    if (camera && position) view_inverse(camera, rotation, position);
}

static int same_matrix(const gffe_camera *a, const gffe_camera *b) {
    int i, j;
    for (i = 0; i < 4; ++i)
        for (j = 0; j < 4; ++j)
            if (a->world_to_view[i][j] != b->world_to_view[i][j]) return 0;
    return 1;
}

/* Computes the transform from the view space of `a` to that of `b`: rows of a 3x4 matrix, exactly the identity for
   equal poses. */
void gffe_view_transform(const gffe_camera *a, const gffe_camera *b, double made[3][4]) {
    double rotation[3][3], translation[3], other[3][3], turned[3][3], moved[3];
    int i, j;
    if (!a || !b || !made) return;
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
    gffe_camera made;
    memset(&made, 0, sizeof made);
    if (!camera) return made;
    made = *camera;
    made.fx = camera->fx * scale_x;
    made.fy = camera->fy * scale_y;
    made.cx = camera->cx * scale_x;
    made.cy = camera->cy * scale_y;
    return made;
}

int gffe_have_one_pose(const gffe_camera *render, const gffe_camera *display) {
    double most = 0;
    int i, j;
    if (!render || !display) return 0;
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
    int i, j;
    if (!a || !b || a->fx != b->fx || a->fy != b->fy || a->cx != b->cx || a->cy != b->cy) return 0;
    for (i = 0; i < 4; ++i)
        for (j = 0; j < 4; ++j)
            if (a->world_to_view[i][j] != b->world_to_view[i][j]) return 0;
    return 1;
}

void gffe_reprojection(const gffe_camera *source, const gffe_camera *target, float made[24]) {
    double matrix[3][4];
    int i, j;
    if (!source || !target || !made) return;
    gffe_view_transform(source, target, matrix);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 4; ++j) made[4 * i + j] = (float)matrix[i][j];
    made[12] = (float)source->fx;
    made[13] = (float)source->fy;
    made[14] = (float)source->cx;
    made[15] = (float)source->cy;
    made[16] = (float)(1 / source->fx);
    made[17] = (float)(1 / source->fy);
    made[18] = (float)source->cx;
    made[19] = (float)source->cy;
    made[20] = (float)target->fx;
    made[21] = (float)target->fy;
    made[22] = (float)target->cx;
    made[23] = (float)target->cy;
}

void gffe_zoom(const gffe_camera *source, const gffe_camera *target, float made[2]) {
    if (!source || !target || !made) return;
    made[0] = (float)(target->fx / source->fx);
    made[1] = (float)(target->fy / source->fy);
}

void gffe_mapping(const gffe_camera *a, const gffe_camera *b, float made[4]) {
    double scale_x, scale_y;
    if (!a || !b || !made) return;
    scale_x = b->fx / a->fx;
    scale_y = b->fy / a->fy;
    made[0] = (float)scale_x;
    made[1] = (float)scale_y;
    made[2] = (float)(b->cx - scale_x * a->cx);
    made[3] = (float)(b->cy - scale_y * a->cy);
}

static void set_pose(gffe_camera *camera, double rotation[3][3], const double position[3]) {
    double moved[3];
    int i, j;
    times_vector(rotation, position, moved);
    for (i = 0; i < 3; ++i) {
        for (j = 0; j < 3; ++j) camera->world_to_view[i][j] = rotation[i][j];
        camera->world_to_view[i][3] = -moved[i];
        camera->world_to_view[3][i] = 0;
    }
    camera->world_to_view[3][3] = 1;
}

static double ahead(double alpha, double a, double b) { return b + alpha * (b - a); }

static double larger(double a, double b) { return b > a ? b : a; }

static double smaller(double a, double b) { return b < a ? b : a; }

/* predict_camera: the linear prediction, per pose vector. */
static const char *predict(const gffe_camera *previous, const gffe_camera *current, double alpha, gffe_camera *made) {
    double position[2][3], direction[3], ups[3][3], at[3], axes[3][3], right[3], least, own[3][3];
    int k, up;
    if (!(fabs(alpha) <= GFFE_MOST_ALPHA)) return "camera: alpha must be a finite number of intervals, up to a million";
    gffe_position(previous, position[0]);
    gffe_position(current, position[1]);
    for (k = 0; k < 3; ++k) {
        direction[k] = ahead(alpha, previous->world_to_view[2][k], current->world_to_view[2][k]);
        ups[0][k] = ahead(alpha, -previous->world_to_view[1][k], -current->world_to_view[1][k]);
        ups[1][k] = -current->world_to_view[1][k];
        ups[2][k] = -current->world_to_view[2][k];
        at[k] = ahead(alpha, position[0][k], position[1][k]);
    }
    least = 1e-6 * gffe_length(direction);
    for (up = 0; up < 2; ++up) { /* the last two cannot both be parallel to the direction */
        cross(direction, ups[up], right);
        if (gffe_length(right) > least) break;
    }
    if (!normalized(direction, axes[2])) return "camera: direction has no length";
    cross(axes[2], ups[up], right);
    if (!normalized(right, axes[0])) return "camera: up (parallel to the direction) has no length";
    cross(axes[2], axes[0], axes[1]);
    *made = *current;
    made->fx = larger(ahead(alpha, previous->fx, current->fx), current->fx * 0.1);
    made->fy = larger(ahead(alpha, previous->fy, current->fy), current->fy * 0.1);
    if (same_matrix(previous, current)) return NULL;
    set_pose(made, axes, at);
    rotation_of(current, own);
    if (determinant(own) < 0) /* left-handed world */
        for (k = 0; k < 4; ++k) made->world_to_view[0][k] *= -1;
    return NULL;
}

/* ---- prediction from several cameras (gffe_cl/engine/frame/camera_prediction.py)
   ------------------------------------------ */

/* Computes the rotation vector from the view of `old` to that of `new`: axis times angle. */
static void turn_between(const gffe_camera *older, const gffe_camera *newer, double made[3]) {
    double r[3][3], doubled[3], sine, cosine, scale;
    int i, j;
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) r[i][j] = dot(newer->world_to_view[i], older->world_to_view[j]);
    doubled[0] = r[2][1] - r[1][2];
    doubled[1] = r[0][2] - r[2][0];
    doubled[2] = r[1][0] - r[0][1];
    sine = gffe_length(doubled) / 2;
    cosine = (r[0][0] + r[1][1] + r[2][2] - 1) / 2;
    scale = sine > 1e-12 ? atan2(sine, cosine) / sine : 0;
    for (i = 0; i < 3; ++i) made[i] = sine > 1e-12 ? doubled[i] / 2 * scale : 0;
}

static void rotation_matrix(const double vector[3], double made[3][3]) {
    const double angle = gffe_length(vector);
    double x, y, z, sine, versine, crossed[3][3], twice[3][3];
    int i, j;
    if (angle < 1e-15) {
        for (i = 0; i < 3; ++i)
            for (j = 0; j < 3; ++j) made[i][j] = i == j;
        return;
    }
    x = vector[0] / angle;
    y = vector[1] / angle;
    z = vector[2] / angle;
    sine = sin(angle);
    versine = 1 - cos(angle);
    crossed[0][0] = crossed[1][1] = crossed[2][2] = 0;
    crossed[0][1] = -z;
    crossed[0][2] = y;
    crossed[1][0] = z;
    crossed[1][2] = -x;
    crossed[2][0] = -y;
    crossed[2][1] = x;
    product(crossed, crossed, twice);
    for (i = 0; i < 3; ++i)
        for (j = 0; j < 3; ++j) made[i][j] = (i == j ? 1.0 : 0.0) + sine * crossed[i][j] + versine * twice[i][j];
}

static int is_jump(double motion[][3], int k) {
    return gffe_length(motion[k]) > GFFE_JUMP * gffe_length(motion[k + 1]);
}

/* Computes the part of changes[k] that lasts. */
static void lasting_change(double motion[][3], const double *steps, double changes[][3], int k, double made[3]) {
    const double square = dot(changes[k + 1], changes[k + 1]), squared = steps[k + 1] * steps[k + 1];
    double lasting = 0;
    int c;
    if (square * (squared * squared) > GFFE_LEAST_CHANGE)
        lasting = smaller(larger(dot(changes[k], changes[k + 1]) / square, 0), 1);
    for (c = 0; c < 3; ++c) made[c] = is_jump(motion, k) ? 0 : lasting * changes[k][c];
}

/* Ridge regression with exponential forgetting: the next change of velocity is the last one, plus three inputs times
   coefficients that all components share. */
typedef struct next_change {
    double products[3][3]; /* of inputs and inputs */
    double targets[3];     /* products of inputs and targets of prediction */
    double gained, moved;  /* correction times error of the usual prediction, and squared correction */
} next_change;

/* Computes the further inputs to predict the change after changes[k]. */
static void make_inputs(double speeds[][3], double changes[][3], int k, double made[3][3]) {
    int c;
    for (c = 0; c < 3; ++c) {
        made[0][c] = speeds[k][c];
        made[1][c] = changes[k][c];
        made[2][c] = changes[k][c] - changes[k + 1][c];
    }
}

/* Solves matrix * x = right for a symmetric matrix; x is 0 where rounding leaves no solution. */
static void solve(double matrix[3][3], const double right[3], double made[3]) {
    double columns[3][3], scale;
    int i;
    cross(matrix[1], matrix[2], columns[0]);
    cross(matrix[2], matrix[0], columns[1]);
    cross(matrix[0], matrix[1], columns[2]);
    scale = dot(matrix[0], columns[0]);
    for (i = 0; i < 3; ++i) made[i] = scale > 0 ? dot(columns[i], right) / scale : 0;
}

/* Computes the difference between the model's prediction and `usual`. */
static void correction_of(const next_change *model, double inputs[3][3], const double usual[3], double made[3]) {
    double matrix[3][3], factors[3], scale;
    int i, c;
    memcpy(matrix, model->products, sizeof matrix);
    for (i = 0; i < 3; ++i) {
        scale = model->products[i][i] + dot(inputs[i], inputs[i]);
        matrix[i][i] += scale > 0 ? GFFE_RIDGE * scale : 1.0;
    }
    solve(matrix, model->targets, factors);
    for (c = 0; c < 3; ++c)
        made[c] = inputs[1][c] - usual[c]
                  + (factors[0] * inputs[0][c] + factors[1] * inputs[1][c] + factors[2] * inputs[2][c]);
}

/* Returns the share of `correction` that would have minimized the errors so far. */
static double trust(const next_change *model, const double correction[3]) {
    const double moved = model->moved + GFFE_RIDGE * dot(correction, correction);
    return model->gained > 0 && moved > 0 ? smaller(model->gained / moved, 1) : 0;
}

/* Adds the change that came after `inputs`, for which `correction` was predicted, to the regression. */
static void learn(next_change *model, double inputs[3][3], const double usual[3], const double correction[3],
                  const double change[3]) {
    double error[3], wanted[3];
    int i, j;
    for (i = 0; i < 3; ++i) {
        error[i] = change[i] - usual[i];
        wanted[i] = change[i] - inputs[1][i];
    }
    model->gained = GFFE_FORGETTING * model->gained + dot(correction, error);
    model->moved = GFFE_FORGETTING * model->moved + dot(correction, correction);
    for (i = 0; i < 3; ++i) {
        model->targets[i] = GFFE_FORGETTING * model->targets[i] + dot(inputs[i], wanted);
        for (j = 0; j <= i; ++j)
            model->products[i][j] = model->products[j][i] =
                GFFE_FORGETTING * model->products[i][j] + dot(inputs[i], inputs[j]);
    }
}

/* Predicts the next second divided difference of a movement `motion`, newest first, in `steps` of time. */
static void predict_change(double motion[][3], const double *steps, int count, double made[3]) {
    double speeds[GFFE_POSES][3], changes[GFFE_POSES][3], inputs[3][3], usual[3], correction[3], share;
    next_change model;
    int i, k;
    for (i = 0; i < count; ++i)
        for (k = 0; k < 3; ++k) speeds[i][k] = motion[i][k] / steps[i];
    for (i = 0; i + 1 < count; ++i)
        for (k = 0; k < 3; ++k) changes[i][k] = (speeds[i][k] - speeds[i + 1][k]) / (steps[i] + steps[i + 1]);
    if (count == 2) {
        for (k = 0; k < 3; ++k) made[k] = is_jump(motion, 0) ? 0 : changes[0][k];
        return;
    }
    memset(&model, 0, sizeof model);
    for (i = count - 3;; --i) {
        make_inputs(speeds, changes, i, inputs);
        lasting_change(motion, steps, changes, i, usual);
        correction_of(&model, inputs, usual, correction);
        if (i == 0) break;
        learn(&model, inputs, usual, correction, changes[i - 1]);
    }
    share = trust(&model, correction);
    for (k = 0; k < 3; ++k) made[k] = usual[k] + share * correction[k];
}

const char *gffe_predict_camera_at(double time, const gffe_camera *cameras, const double *times, int count, int order,
                                   gffe_camera *made) {
    double steps[GFFE_POSES], moves[GFFE_POSES][3], turns[GFFE_POSES][3], move[3], turn[3], positions[GFFE_POSES][3];
    double to, factor, turning[3][3], own[3][3], rotation[3][3], position[3];
    const char *fault;
    int i, k, any = 0;
    if (!cameras || !times || !made) return "camera: cameras, times and made must not be NULL";
    if (order < 0 || order > 2) return "camera: the order of its prediction must be 0 (automatic), 1 or 2";
    if (order && count > 4) count = 4;
    if (count > GFFE_POSES) count = GFFE_POSES;
    if (count < 1 || !is_finite(times, count)) return "camera: needs one decreasing time per camera, and one camera";
    for (i = 0; i + 1 < count; ++i) {
        steps[i] = times[i] - times[i + 1];
        if (!(steps[i] > 0)) return "camera: needs one decreasing time per camera, and one camera";
    }
    for (i = 0; i < count; ++i) {
        fault = gffe_camera_fault(&cameras[i]);
        if (fault) return fault;
    }
    if (!(fabs(time) < GFFE_LARGEST)) return "camera: time must be finite, and below 1e300 s";
    *made = cameras[0];
    if (count == 1) return NULL;
    to = time - times[0];
    fault = predict(&cameras[1], &cameras[0], to / steps[0], made);
    if (!fault) fault = gffe_camera_fault(made);
    if (fault || order == 1 || count == 2) return fault;
    for (i = 0; i < count; ++i) gffe_position(&cameras[i], positions[i]);
    for (i = 0; i + 1 < count; ++i) {
        for (k = 0; k < 3; ++k) moves[i][k] = positions[i][k] - positions[i + 1][k];
        turn_between(&cameras[i + 1], &cameras[i], turns[i]);
    }
    factor = to * (to + steps[0]);
    predict_change(moves, steps, count - 1, move);
    predict_change(turns, steps, count - 1, turn);
    for (k = 0; k < 3; ++k) {
        move[k] = factor * move[k];
        turn[k] = factor * turn[k];
        any = any || move[k] != 0 || turn[k] != 0;
    }
    if (!any) return NULL;
    rotation_matrix(turn, turning);
    rotation_of(made, own);
    product(turning, own, rotation);
    gffe_position(made, position);
    for (k = 0; k < 3; ++k) position[k] = position[k] + move[k];
    set_pose(made, rotation, position);
    return gffe_camera_fault(made);
}
