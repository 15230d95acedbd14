/* Example: reads raw frames, as `gffe export OUT --frames SEQUENCE` writes them, and writes the extrapolated ones.

       gffe_example FRAMES OUT [PART OF A PLATFORM'S NAME]

   FRAMES/frames.txt lists the frames, one per line:

       gffe-raw 1 WIDTH HEIGHT RENDER_WIDTH RENDER_HEIGHT FPS
       frame NAME TIME RESET CAMERA CAMERA    a rendered frame: NAME.color (half x 4), NAME.depth, NAME.motion (float);
                                              its render camera and its display camera
       make NAME TIME CAMERA                  a frame to extrapolate, and the camera that sees it

   A CAMERA is 16 numbers: three rows of world_to_view, then fx fy cx cy. OUT gets NAME.color, NAME.depth, NAME.motion,
   NAME.filled_by, and NAME.ppm to look at. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "gffe.h"

enum { MOST_PLATFORMS = 16, LINE = 8192, NAME = 256, SLOTS = 3, PARTS = 4 };
static const char *const parts[PARTS] = {"color", "depth", "motion", "filled_by"};
static const size_t bytes[PARTS] = {8, 4, 8, 1};

static void need(int holds, const char *what, const char *why) {
    if (holds) return;
    fprintf(stderr, "gffe_example: %s: %s\n", what, why);
    exit(2);
}

static FILE *open_file(const char *folder, const char *name, const char *part, const char *mode) {
    char path[4 * NAME];
    FILE *file;
    need(snprintf(path, sizeof path, "%s/%s.%s", folder, name, part) < (int)sizeof path, name, "the path is too long");
    file = fopen(path, mode);
    need(file != NULL, path, *mode == 'r' ? "cannot be read" : "cannot be written");
    return file;
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

static double next_number(char **text, const char *name) {
    char *end;
    const double number = strtod(*text, &end);
    need(end != *text, name, "its line in frames.txt has too few numbers");
    *text = end;
    return number;
}

static gffe_camera next_camera(char **text, const char *name) {
    gffe_camera camera = {{{0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 1}}, 0, 0, 0, 0};
    int k;
    for (k = 0; k < 12; ++k) camera.world_to_view[k / 4][k % 4] = next_number(text, name);
    camera.fx = next_number(text, name);
    camera.fy = next_number(text, name);
    camera.cx = next_number(text, name);
    camera.cy = next_number(text, name);
    return camera;
}

/* Writes linear color, four halves per pixel, as a picture in sRGB. */
static void write_picture(FILE *file, const gffe_options *size, const unsigned short *color) {
    int k;
    fprintf(file, "P6\n%d %d\n255\n", size->width, size->height);
    for (k = 0; k < 4 * size->width * size->height; ++k) {
        const int exponent = color[k] >> 10 & 31, mantissa = color[k] & 1023;
        double value = exponent ? ldexp(mantissa + 1024, exponent - 25) : ldexp(mantissa, -24);
        value = color[k] & 0x8000 ? 0 : fmin(value, 1);
        value = value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055;
        if (k % 4 < 3) fputc((int)(value * 255 + 0.5), file);
    }
}

int main(int count, char **arguments) {
    char line[LINE], what[NAME], name[NAME];
    cl_mem slots[SLOTS][PARTS - 1]; /* two of the last frames are in use while the next one is written */
    gffe_options size = gffe_default_options(0, 0);
    cl_device_id device;
    cl_context context;
    cl_command_queue queue;
    size_t pixels, shown;
    void *memory;
    FILE *list;
    gffe *g;
    int version, part, slot = 0, used;

    need(count > 2, "usage", "gffe_example FRAMES OUT [PLATFORM]");
    list = open_file(arguments[1], "frames", "txt", "r");
    need(fgets(line, sizeof line, list)
             && sscanf(line, "gffe-raw %d %d %d %d %d %lf", &version, &size.width, &size.height, &size.render_width,
                       &size.render_height, &size.fps)
                    == 6
             && version == 1,
         "frames.txt", "does not begin with 'gffe-raw 1 WIDTH HEIGHT RENDER_WIDTH RENDER_HEIGHT FPS'");
    device = open_device(count > 3 ? arguments[3] : "");
    context = clCreateContext(NULL, 1, &device, NULL, NULL, NULL);
    queue = context ? clCreateCommandQueue(context, device, 0, NULL) : NULL;
    need(queue != NULL, "OpenCL", "the device cannot be opened");
    need(!gffe_create(context, queue, &size, &g), "gffe_create", gffe_message(g));
    pixels = (size_t)size.render_width * (size_t)size.render_height;
    shown = (size_t)size.width * (size_t)size.height;
    memory = malloc(8 * (pixels > shown ? pixels : shown));
    need(memory != NULL, "memory", "there is too little");
    for (slot = 0; slot < SLOTS; ++slot)
        for (part = 0; part < PARTS - 1; ++part) {
            slots[slot][part] = clCreateBuffer(context, CL_MEM_READ_ONLY, bytes[part] * pixels, NULL, NULL);
            need(slots[slot][part] != NULL, "device memory", "there is too little");
        }

    while (fgets(line, sizeof line, list) && sscanf(line, "%250s %250s%n", what, name, &used) == 2) {
        char *text = line + used;
        const double time = next_number(&text, name);
        FILE *file;
        if (!strcmp(what, "frame")) {
            const int reset = next_number(&text, name) != 0;
            const gffe_camera render = next_camera(&text, name), display = next_camera(&text, name);
            cl_mem *given = slots[++slot % SLOTS];
            for (part = 0; part < PARTS - 1; ++part) {
                file = open_file(arguments[1], name, parts[part], "rb");
                need(fread(memory, bytes[part], pixels, file) == pixels, name, "the file is too short");
                fclose(file);
                need(!clEnqueueWriteBuffer(queue, given[part], CL_TRUE, 0, bytes[part] * pixels, memory, 0, NULL, NULL),
                     name, "cannot be copied to the device");
            }
            need(!gffe_submit(g, given[0], given[1], given[2], &render, &display, time, reset), name, gffe_message(g));
        } else {
            const gffe_camera camera = next_camera(&text, name);
            gffe_frame made;
            need(!gffe_extrapolate(g, &camera, time, &made), name, gffe_message(g));
            for (part = PARTS - 1; part >= 0; --part) { /* the picture is made of the last one */
                const cl_mem from[PARTS] = {made.color, made.depth, made.motion, made.filled_by};
                need(!clEnqueueReadBuffer(queue, from[part], CL_TRUE, 0, bytes[part] * shown, memory, 0, NULL, NULL),
                     name, "cannot be read from the device");
                file = open_file(arguments[2], name, parts[part], "wb");
                need(fwrite(memory, bytes[part], shown, file) == shown && !fclose(file), name, "cannot be written");
            }
            file = open_file(arguments[2], name, "ppm", "wb");
            write_picture(file, &size, (const unsigned short *)memory);
            need(!fclose(file), name, "cannot be written");
        }
    }

    gffe_destroy(g);
    for (slot = 0; slot < SLOTS; ++slot)
        for (part = 0; part < PARTS - 1; ++part) clReleaseMemObject(slots[slot][part]);
    clReleaseCommandQueue(queue);
    clReleaseContext(context);
    free(memory);
    fclose(list);
    return 0;
}
