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

enum { MOST_PLATFORMS = 16, LINE = 8192, NAME = 256, SLOTS = 3, BUFFERS = 3 };
static const char *const PARTS[BUFFERS] = {"color", "depth", "motion"};
static const size_t BYTES[BUFFERS] = {8, 4, 8};

typedef struct example {
    cl_context context;
    cl_command_queue queue;
    gffe *g;
    const char *input, *output;
    gffe_options options;
    cl_mem slots[SLOTS][BUFFERS]; /* two of the last frames are in use while the next one is written */
    int slot;
    unsigned char *pixels;
} example;

static int failed(const char *what, const char *why) {
    fprintf(stderr, "gffe_example: %s: %s\n", what, why);
    return 0;
}

static size_t render_pixels(const example *e) {
    return (size_t)e->options.render_width * (size_t)e->options.render_height;
}

static size_t display_pixels(const example *e) { return (size_t)e->options.width * (size_t)e->options.height; }

/* ---- files -------------------------------------------------------------------------------------------- */

static FILE *open_file(const char *folder, const char *name, const char *part, const char *mode) {
    char path[4 * NAME];
    FILE *file;
    if (snprintf(path, sizeof path, "%s/%s%s%s", folder, name, *part ? "." : "", part) >= (int)sizeof path) return NULL;
    file = fopen(path, mode);
    if (!file) failed(path, *mode == 'r' ? "cannot be read" : "cannot be written");
    return file;
}

static int read_part(example *e, const char *name, int part) {
    const size_t nbytes = BYTES[part] * render_pixels(e);
    FILE *file = open_file(e->input, name, PARTS[part], "rb");
    size_t count;
    if (!file) return 0;
    count = fread(e->pixels, 1, nbytes, file);
    fclose(file);
    return count == nbytes ? 1 : failed(name, "the file is too short");
}

static int write_part(const example *e, const char *name, const char *part, const void *bytes, size_t nbytes) {
    FILE *file = open_file(e->output, name, part, "wb");
    size_t count;
    if (!file) return 0;
    count = fwrite(bytes, 1, nbytes, file);
    return (fclose(file) == 0 && count == nbytes) ? 1 : failed(name, "cannot be written");
}

static double from_half(unsigned bits) {
    const int exponent = (int)(bits >> 10 & 31u);
    const double mantissa = bits & 1023u, sign = bits & 0x8000u ? -1 : 1;
    return sign * (exponent ? ldexp(mantissa + 1024, exponent - 25) : ldexp(mantissa, -24));
}

/* Converts linear color to sRGB in place: three bytes per pixel. */
static void to_display(unsigned char *pixels, size_t count) {
    size_t k;
    int c;
    for (k = 0; k < count; ++k)
        for (c = 0; c < 3; ++c) {
            const unsigned char *half = pixels + 8 * k + 2 * c;
            double value = from_half((unsigned)half[0] | (unsigned)half[1] << 8);
            value = value > 0 ? (value < 1 ? value : 1) : 0;
            value = value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1 / 2.4) - 0.055;
            pixels[3 * k + (size_t)c] = (unsigned char)(value * 255 + 0.5);
        }
}

static int write_picture(const example *e, const char *name, unsigned char *color) {
    FILE *file = open_file(e->output, name, "ppm", "wb");
    size_t count;
    if (!file) return 0;
    to_display(color, display_pixels(e));
    fprintf(file, "P6\n%d %d\n255\n", e->options.width, e->options.height);
    count = fwrite(color, 3, display_pixels(e), file);
    return (fclose(file) == 0 && count == display_pixels(e)) ? 1 : failed(name, "cannot be written");
}

/* ---- OpenCL ------------------------------------------------------------------------------------------- */

/* Opens the first device of the first platform whose name holds `wanted`, and returns whether that succeeded. */
static int open_device(example *e, const char *wanted) {
    cl_platform_id platforms[MOST_PLATFORMS];
    cl_device_id device = NULL;
    cl_uint count = 0, k;
    cl_int error;
    if (clGetPlatformIDs(MOST_PLATFORMS, platforms, &count) != CL_SUCCESS) count = 0;
    for (k = 0; k < count && !device; ++k) {
        char name[NAME] = "";
        clGetPlatformInfo(platforms[k], CL_PLATFORM_NAME, sizeof name - 1, name, NULL);
        if (strstr(name, wanted) && clGetDeviceIDs(platforms[k], CL_DEVICE_TYPE_ALL, 1, &device, NULL) != CL_SUCCESS)
            device = NULL;
    }
    if (!device) return failed("OpenCL", "there is no such platform, or it has no device");
    e->context = clCreateContext(NULL, 1, &device, NULL, NULL, &error);
    if (e->context) e->queue = clCreateCommandQueue(e->context, device, 0, &error);
    return e->queue ? 1 : failed("OpenCL", "the device cannot be opened");
}

static int open_pipeline(example *e) {
    const size_t most = render_pixels(e) > display_pixels(e) ? render_pixels(e) : display_pixels(e);
    int slot, part;
    e->pixels = (unsigned char *)malloc(8 * most);
    if (!e->pixels) return failed("memory", "there is too little");
    for (slot = 0; slot < SLOTS; ++slot)
        for (part = 0; part < BUFFERS; ++part) {
            e->slots[slot][part] =
                clCreateBuffer(e->context, CL_MEM_READ_ONLY, BYTES[part] * render_pixels(e), NULL, NULL);
            if (!e->slots[slot][part]) return failed("device memory", "there is too little");
        }
    if (gffe_create(e->context, e->queue, &e->options, &e->g)) return failed("gffe_create", gffe_message(e->g));
    return 1;
}

static void close_example(example *e) {
    int slot, part;
    gffe_destroy(e->g);
    for (slot = 0; slot < SLOTS; ++slot)
        for (part = 0; part < BUFFERS; ++part)
            if (e->slots[slot][part]) clReleaseMemObject(e->slots[slot][part]);
    if (e->queue) clReleaseCommandQueue(e->queue);
    if (e->context) clReleaseContext(e->context);
    free(e->pixels);
}

/* ---- frames ------------------------------------------------------------------------------------------- */

static char *next_number(char *text, double *number) {
    char *end;
    *number = strtod(text, &end);
    return end == text ? NULL : end;
}

/* Reads a camera, and returns where the text continues, or NULL. */
static char *next_camera(char *text, gffe_camera *camera) {
    double *intrinsics[4];
    int k;
    intrinsics[0] = &camera->fx;
    intrinsics[1] = &camera->fy;
    intrinsics[2] = &camera->cx;
    intrinsics[3] = &camera->cy;
    memset(camera, 0, sizeof *camera);
    camera->world_to_view[3][3] = 1;
    for (k = 0; k < 12 && text; ++k) text = next_number(text, &camera->world_to_view[k / 4][k % 4]);
    for (k = 0; k < 4 && text; ++k) text = next_number(text, intrinsics[k]);
    return text;
}

static int submit(example *e, const char *name, char *text) {
    gffe_camera render, display;
    double time = 0, reset = 0;
    cl_mem *slot = e->slots[e->slot];
    int part;
    text = next_number(text, &time);
    if (text) text = next_number(text, &reset);
    if (text) text = next_camera(text, &render);
    if (text) text = next_camera(text, &display);
    if (!text) return failed(name, "the line is no 'frame NAME TIME RESET CAMERA CAMERA'");
    e->slot = (e->slot + 1) % SLOTS;
    for (part = 0; part < BUFFERS; ++part) {
        if (!read_part(e, name, part)) return 0;
        if (clEnqueueWriteBuffer(e->queue, slot[part], CL_TRUE, 0, BYTES[part] * render_pixels(e), e->pixels, 0, NULL,
                                 NULL)
            != CL_SUCCESS)
            return failed(name, "cannot be copied to the device");
    }
    if (gffe_submit(e->g, slot[0], slot[1], slot[2], &render, &display, time, reset != 0))
        return failed(name, gffe_message(e->g));
    return 1;
}

static int make(example *e, const char *name, char *text) {
    static const char *const parts[] = {"filled_by", "motion", "depth", "color"}; /* the picture is made of the last */
    static const size_t bytes[] = {1, 8, 4, 8};
    gffe_camera camera;
    gffe_frame made;
    double time = 0;
    cl_mem memory[4];
    int k;
    text = next_number(text, &time);
    if (text) text = next_camera(text, &camera);
    if (!text) return failed(name, "the line is no 'make NAME TIME CAMERA'");
    if (gffe_extrapolate(e->g, &camera, time, &made)) return failed(name, gffe_message(e->g));
    memory[0] = made.filled_by;
    memory[1] = made.motion;
    memory[2] = made.depth;
    memory[3] = made.color;
    for (k = 0; k < 4; ++k) {
        const size_t nbytes = bytes[k] * display_pixels(e);
        if (clEnqueueReadBuffer(e->queue, memory[k], CL_TRUE, 0, nbytes, e->pixels, 0, NULL, NULL) != CL_SUCCESS)
            return failed(name, "cannot be read from the device");
        if (!write_part(e, name, parts[k], e->pixels, nbytes)) return 0;
    }
    return write_picture(e, name, e->pixels);
}

static int run_line(example *e, char *line) {
    char what[NAME], name[NAME];
    int used = 0;
    if (sscanf(line, "%250s %250s%n", what, name, &used) != 2) return *line == '\n' || failed("frames.txt", line);
    if (!strcmp(what, "frame")) return submit(e, name, line + used);
    if (!strcmp(what, "make")) return make(e, name, line + used);
    return failed("frames.txt", line);
}

static int run(example *e, const char *platform) {
    char line[LINE];
    int version = 0, good = 0;
    FILE *file = open_file(e->input, "frames.txt", "", "r");
    if (!file) return 0;
    if (!fgets(line, sizeof line, file)
        || sscanf(line, "gffe-raw %d %d %d %d %d %lf", &version, &e->options.width, &e->options.height,
                  &e->options.render_width, &e->options.render_height, &e->options.fps)
               != 6
        || version != 1)
        failed("frames.txt", "does not begin with 'gffe-raw 1 WIDTH HEIGHT RENDER_WIDTH RENDER_HEIGHT FPS'");
    else
        good = open_device(e, platform) && open_pipeline(e);
    while (good && fgets(line, sizeof line, file)) good = run_line(e, line);
    fclose(file);
    return good;
}

int main(int count, char **arguments) {
    example e;
    int good;
    memset(&e, 0, sizeof e);
    if (count < 3) {
        fprintf(stderr, "usage: gffe_example FRAMES OUT [PLATFORM]\n");
        return 2;
    }
    e.input = arguments[1];
    e.output = arguments[2];
    e.options = gffe_default_options(0, 0);
    good = run(&e, count > 3 ? arguments[3] : "");
    close_example(&e);
    return good ? 0 : 2;
}
