/* Example: renders a red square that moves before a wall, seen by a camera that moves, too, and makes the frame halfway
   after each rendered one.

       gffe_example OUT [PART OF A PLATFORM'S NAME]

   OUT gets rendered_00.ppm and made_00.ppm, rendered_01.ppm ... to look at. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gffe.h"

enum { MOST_PLATFORMS = 16, NAME = 1024, WIDTH = 320, HEIGHT = 180, PIXELS = WIDTH * HEIGHT, FRAMES = 8 };
enum { SETS = 3, PARTS = 3 }; /* of buffers: two of the last frames are in use while the next is written */
static const size_t bytes[PARTS] = {8, 4, 8}; /* per pixel, of color, depth and motion */
static const double FPS = 30, WALL = 6, SQUARE = 3, HALF = 0.5, SPEED = 3,
                    CAMERA_SPEED = 0.6; /* world units, seconds */

static void need(int holds, const char *what, const char *why) {
    if (holds) return;
    fprintf(stderr, "gffe_example: %s: %s\n", what, why);
    exit(2);
}

static cl_device_id open_device(const char *wanted) {
    cl_platform_id platforms[MOST_PLATFORMS];
    cl_device_id device = NULL;
    cl_uint count = 0, k;
    if (clGetPlatformIDs(MOST_PLATFORMS, platforms, &count) != CL_SUCCESS) count = 0;
    for (k = 0; k < count && !device; ++k) {
        char name[NAME] = "";
        clGetPlatformInfo(platforms[k], CL_PLATFORM_NAME, sizeof name - 1, name, NULL);
        if (strstr(name, wanted) && clGetDeviceIDs(platforms[k], CL_DEVICE_TYPE_ALL, 1, &device, NULL) != CL_SUCCESS)
            device = NULL;
    }
    need(device != NULL, "OpenCL", "there is no such platform, or it has no device");
    return device;
}

/* Returns the camera, which looks along z and moves along x. */
static gffe_camera camera_at(double time) {
    gffe_camera camera = {
        {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}}, WIDTH, WIDTH, WIDTH / 2., HEIGHT / 2.};
    camera.world_to_view[0][3] = -CAMERA_SPEED * time;
    return camera;
}

/* Returns the bits of a half float, of a value from 1/1024 to 1. */
static unsigned short half_of(double value) {
    int exponent;
    const double part = frexp(value, &exponent);
    return (unsigned short)(((exponent + 14) << 10) + (int)(part * 2048 - 1024 + 0.5));
}

/* Renders color (halves), depth and motion: the place of the same point one frame before, minus its place now. */
static void render(double time, unsigned short *color, float *depth, float *motion) {
    int x, y;
    for (y = 0; y < HEIGHT; ++y)
        for (x = 0; x < WIDTH; ++x) {
            const double right = (x + 0.5 - WIDTH / 2.) / WIDTH, down = (y + 0.5 - HEIGHT / 2.) / WIDTH;
            const double across =
                SQUARE * right + CAMERA_SPEED * time - (SPEED * time - 1); /* from the square's center */
            const int on_square = fabs(across) < HALF && fabs(SQUARE * down) < HALF;
            const double z = on_square ? SQUARE : WALL, speed = on_square ? SPEED : 0;
            const int tile = (int)floor(2 * (z * right + CAMERA_SPEED * time)) + (int)floor(2 * z * down);
            const unsigned short light = half_of(tile & 1 ? 0.5 : 0.2), red = half_of(0.8), dark = half_of(0.05);
            const int k = y * WIDTH + x;
            color[4 * k] = on_square ? red : light;
            color[4 * k + 1] = color[4 * k + 2] = on_square ? dark : light;
            color[4 * k + 3] = half_of(1);
            depth[k] = (float)z;
            motion[2 * k] = (float)((CAMERA_SPEED - speed) / FPS * WIDTH / z);
            motion[2 * k + 1] = 0;
        }
}

/* Writes linear color, four halves per pixel, as a picture in sRGB. */
static void write_picture(const char *folder, const char *kind, int number, const unsigned short *color) {
    char path[NAME];
    FILE *file;
    int k;
    need(snprintf(path, sizeof path, "%s/%s_%02d.ppm", folder, kind, number) < NAME, folder, "the path is too long");
    file = fopen(path, "wb");
    need(file != NULL, path, "cannot be written");
    fprintf(file, "P6\n%d %d\n255\n", WIDTH, HEIGHT);
    for (k = 0; k < 4 * PIXELS; ++k) {
        const int exponent = color[k] >> 10 & 31, mantissa = color[k] & 1023;
        double value = exponent ? ldexp(mantissa + 1024, exponent - 25) : ldexp(mantissa, -24);
        value = color[k] & 0x8000 ? 0 : fmin(value, 1);
        value = value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055;
        if (k % 4 < 3) fputc((int)(value * 255 + 0.5), file);
    }
    need(!fclose(file), path, "cannot be written");
}

int main(int count, char **arguments) {
    static unsigned short color[4 * PIXELS];
    static float depth[PIXELS], motion[2 * PIXELS];
    const void *const given[PARTS] = {color, depth, motion};
    const gffe_options options = gffe_default_options(WIDTH, HEIGHT);
    cl_mem sets[SETS][PARTS];
    cl_device_id device;
    cl_context context;
    cl_command_queue queue;
    gffe *g;
    int number, part;

    need(count > 1, "usage", "gffe_example OUT [PLATFORM]");
    device = open_device(count > 2 ? arguments[2] : "");
    context = clCreateContext(NULL, 1, &device, NULL, NULL, NULL);
    queue = context ? clCreateCommandQueue(context, device, 0, NULL) : NULL;
    need(queue != NULL, "OpenCL", "the device cannot be opened");
    need(!gffe_create(context, queue, &options, &g), "gffe_create", gffe_message(g));
    for (number = 0; number < SETS; ++number)
        for (part = 0; part < PARTS; ++part) {
            sets[number][part] = clCreateBuffer(context, CL_MEM_READ_ONLY, bytes[part] * PIXELS, NULL, NULL);
            need(sets[number][part] != NULL, "device memory", "there is too little");
        }

    for (number = 0; number < FRAMES; ++number) {
        const double time = number / FPS, later = time + 0.5 / FPS;
        const gffe_camera camera = camera_at(time), next = camera_at(later);
        cl_mem *set = sets[number % SETS];
        gffe_frame made;
        render(time, color, depth, motion);
        for (part = 0; part < PARTS; ++part)
            need(!clEnqueueWriteBuffer(queue, set[part], CL_TRUE, 0, bytes[part] * PIXELS, given[part], 0, NULL, NULL),
                 "a frame", "cannot be copied to the device");
        write_picture(arguments[1], "rendered", number, color);
        need(!gffe_submit(g, set[0], set[1], set[2], &camera, NULL, time, number == 0), "gffe_submit", gffe_message(g));
        need(!gffe_extrapolate(g, &next, later, &made), "gffe_extrapolate", gffe_message(g));
        need(!clEnqueueReadBuffer(queue, made.color, CL_TRUE, 0, sizeof color, color, 0, NULL, NULL), "a frame",
             "cannot be read from the device");
        write_picture(arguments[1], "made", number, color);
    }

    gffe_destroy(g);
    for (number = 0; number < SETS; ++number)
        for (part = 0; part < PARTS; ++part) clReleaseMemObject(sets[number][part]);
    clReleaseCommandQueue(queue);
    clReleaseContext(context);
    return 0;
}
