/* Kernels, and execution of lists of operations. */
#include <stdio.h>
#include <stdlib.h>

#include "gffe_internal.h"

enum { TILE_WIDTH = 16, TILE_HEIGHT = 8 };      /* work-items of a work-group, unless a kernel specifies it ... */
enum { ROW = 128 };                             /* ... and where lanes are several */

/* ---- capabilities of the device ----------------------------------------------------------------------- */

/* Returns the build options that make division and square roots correctly rounded, if the device can. */
static const char *rounding_options(const gffe *g) {
    cl_device_fp_config config = 0;
    clGetDeviceInfo(g->device, CL_DEVICE_SINGLE_FP_CONFIG, sizeof config, &config, NULL);
    return config & CL_FP_CORRECTLY_ROUNDED_DIVIDE_SQRT ? "-cl-fp32-correctly-rounded-divide-sqrt" : "";
}

/* Returns whether the device has a capability, which is tried; a kernel that does not build shows that it lacks it. */
static int has_capability(gffe *g, const gffe_trial *trial) {
    const cl_mem_flags flags = CL_MEM_READ_WRITE | CL_MEM_COPY_HOST_PTR;
    cl_ulong found[2] = {~(cl_ulong)0, ~(cl_ulong)0};
    cl_int error;
    cl_mem buffer = clCreateBuffer(g->context, flags, sizeof found, found, &error);
    cl_program program =
        clCreateProgramWithSource(g->context, (cl_uint)trial->line_count, (const char **)trial->lines, NULL, &error);
    cl_kernel kernel = NULL;
    int works;
    if (program && clBuildProgram(program, 1, &g->device, rounding_options(g), NULL, NULL) == CL_SUCCESS)
        kernel = clCreateKernel(program, trial->name, &error);
    works = buffer && kernel && clSetKernelArg(kernel, 0, sizeof buffer, &buffer) == CL_SUCCESS
            && clEnqueueNDRangeKernel(g->queue, kernel, 1, NULL, &trial->items, NULL, 0, NULL, NULL) == CL_SUCCESS
            && clEnqueueReadBuffer(g->queue, buffer, CL_TRUE, 0, sizeof found, found, 0, NULL, NULL) == CL_SUCCESS
            && found[0] == trial->expected[0] && found[1] == trial->expected[1];
    if (buffer) clReleaseMemObject(buffer);
    if (kernel) clReleaseKernel(kernel);
    if (program) clReleaseProgram(program);
    return works;
}

/* ---- kernels ------------------------------------------------------------------------------------------ */

static gffe_status build(gffe *g, int number, int int64) {
    const gffe_program *program = &gffe_programs[number];
    char choices[192] = "", log[3072] = "";
    size_t used = (size_t)sprintf(choices, "%s", rounding_options(g));
    cl_int error;
    if (program->flags & GFFE_TAKES_LANES) used += (size_t)sprintf(choices + used, " -DLANES=%d", g->lanes);
    if (program->flags & GFFE_TAKES_EXACT_DIVISION && g->exact_division)
        used += (size_t)sprintf(choices + used, " -DEXACT_DIVISION=1");
    if (program->flags & GFFE_TAKES_FLOAT_SUMS && g->options.float_sums)
        used += (size_t)sprintf(choices + used, " -DFLOAT_SUMS=1");
    if (program->flags & GFFE_TAKES_INT64 && int64) sprintf(choices + used, " -DINT64_ATOMICS=1");
    g->programs[number] = clCreateProgramWithSource(g->context, (cl_uint)program->line_count,
                                                    (const char **)program->lines, NULL, &error);
    if (!g->programs[number]) return gffe_checked(g, error, program->name);
    error = clBuildProgram(g->programs[number], 1, &g->device, choices, NULL, NULL);
    if (error == CL_SUCCESS) return GFFE_OK;
    clGetProgramBuildInfo(g->programs[number], g->device, CL_PROGRAM_BUILD_LOG, sizeof log - 1, log, NULL);
    return gffe_fail(g, GFFE_OPENCL, "%s.cl does not build with%s (OpenCL error %d):\n%s", program->name, choices,
                     (int)error, log);
}

static gffe_status set_initial(gffe *g) {
    int k;
    for (k = 0; k < g->plan->initial_count; ++k) {
        const gffe_initial *initial = &g->plan->initial[k];
        const cl_int error =
            clEnqueueWriteBuffer(g->queue, g->memory[2 * initial->buffer], CL_TRUE, 0, (size_t)initial->bytes,
                                 &gffe_constants[initial->words], 0, NULL, NULL);
        if (error != CL_SUCCESS) return gffe_checked(g, error, "writing the initial content of buffers");
    }
    return GFFE_OK;
}

/* Builds the programs that formats need, or all others, and makes their kernels. */
static gffe_status make_kernels(gffe *g, int of_formats, int int64) {
    gffe_status status = GFFE_OK;
    cl_int error;
    int k;
    for (k = 0; k < gffe_program_count && !status; ++k)
        if ((gffe_programs[k].flags & GFFE_OF_FORMATS) == of_formats) status = build(g, k, int64);
    for (k = 0; k < gffe_kernel_count && !status; ++k) {
        const int program = gffe_kernels[k].program;
        if ((gffe_programs[program].flags & GFFE_OF_FORMATS) != of_formats) continue;
        g->kernels[k] = clCreateKernel(g->programs[program], gffe_kernels[k].name, &error);
        if (!g->kernels[k]) status = gffe_checked(g, error, gffe_kernels[k].name);
    }
    return status;
}

gffe_status gffe_open_late(gffe *g) {
    const gffe_status status = make_kernels(g, GFFE_OF_FORMATS, 0);
    return status ? status : gffe_allocate(g, GFFE_OF_FORMATS);
}

gffe_status gffe_open(gffe *g) {
    gffe_status status = GFFE_OK;
    cl_device_type type = 0;
    cl_uint alignment = 0; /* bits */
    cl_int error;
    int int64 = g->options.int64_atomics;
    error = clGetDeviceInfo(g->device, CL_DEVICE_TYPE, sizeof type, &type, NULL);
    if (error == CL_SUCCESS)
        error = clGetDeviceInfo(g->device, CL_DEVICE_MEM_BASE_ADDR_ALIGN, sizeof alignment, &alignment, NULL);
    if (error != CL_SUCCESS) return gffe_checked(g, error, "querying the device");
    g->step.alignment = alignment / 8 > GFFE_LEAST_ALIGNMENT ? alignment / 8 : GFFE_LEAST_ALIGNMENT;
    g->lanes = g->options.lanes ? g->options.lanes : type & CL_DEVICE_TYPE_CPU && !(type & CL_DEVICE_TYPE_GPU) ? 8 : 1;
    if (int64 < 0) int64 = has_capability(g, &gffe_int64_atomics);
    g->exact_division = has_capability(g, &gffe_exact_division);
    g->plan = &gffe_plans[int64];
    g->programs = (cl_program *)calloc((size_t)gffe_program_count, sizeof *g->programs);
    g->kernels = (cl_kernel *)calloc((size_t)gffe_kernel_count, sizeof *g->kernels);
    g->memory = (cl_mem *)calloc(2 * (size_t)g->plan->buffer_count, sizeof *g->memory);
    g->parts = (cl_mem *)calloc(2 * (size_t)g->plan->buffer_count, sizeof *g->parts);
    g->places = (gffe_place *)calloc((size_t)g->plan->buffer_count, sizeof *g->places);
    if (!g->programs || !g->kernels || !g->memory || !g->parts || !g->places)
        return gffe_fail(g, GFFE_OUT_OF_MEMORY, "the host has no memory");
    status = make_kernels(g, 0, int64);
    if (!status) status = gffe_allocate(g, 0);
    if (!status) status = set_initial(g);
    if (!status) g->counts = gffe_reference(g, "scene_cuts.counts");
    g->is_ready = !status;
    return status;
}

/* ---- operations --------------------------------------------------------------------------------------- */

static int step_of(const gffe *g, int step) { return step == GFFE_LANES ? g->lanes : step; }

static cl_int launch(gffe *g, const gffe_operation *operation, const gffe_frame_block *block) {
    const gffe_kernel *kernel = &gffe_kernels[operation->kernel];
    const gffe_argument *argument = g->plan->arguments + operation->first;
    size_t size[3], below[2], group[3] = {1, 1, 1};
    cl_uint count = 0, k;
    cl_int error = clGetKernelInfo(g->kernels[operation->kernel], CL_KERNEL_NUM_ARGS, sizeof count, &count, NULL);
    for (k = 0; k < count && error == CL_SUCCESS; ++k, ++argument) {
        const void *given = block;
        size_t nbytes = sizeof *block;
        if (argument->kind == GFFE_BUFFER) {
            if (!gffe_buffer_bytes(&g->step, &g->plan->buffers[argument->a / 2])) return CL_SUCCESS; /* nothing to do */
            given = &g->memory[argument->a];
            nbytes = sizeof(cl_mem);
        } else if (argument->kind == GFFE_CONSTANT) {
            given = &gffe_constants[argument->a];
            nbytes = (size_t)argument->b;
        }
        error = clSetKernelArg(g->kernels[operation->kernel], k, nbytes, given);
    }
    if (error != CL_SUCCESS) return error;
    gffe_grid_size(&g->step, operation->grid, size);
    group[0] = kernel->group ? (size_t)kernel->group : g->lanes > 1 ? (size_t)ROW : (size_t)TILE_WIDTH;
    group[1] = kernel->group ? (size_t)kernel->group_rows : g->lanes > 1 ? 1 : (size_t)TILE_HEIGHT;
    size[0] = (size[0] + (size_t)step_of(g, kernel->step_x) - 1) / (size_t)step_of(g, kernel->step_x);
    size[1] = (size[1] + (size_t)step_of(g, kernel->step_y) - 1) / (size_t)step_of(g, kernel->step_y);
    size[0] = (size[0] + group[0] - 1) / group[0] * group[0];
    if (kernel->below >= 0) {
        gffe_grid_size(&g->step, kernel->below, below);
        size[1] += (below[0] * below[1] + size[0] - 1) / size[0];
    }
    size[1] = (size[1] + group[1] - 1) / group[1] * group[1];
    size[2] = (size_t)operation->repeats;
    return clEnqueueNDRangeKernel(g->queue, g->kernels[operation->kernel], 3, NULL, size, group, 0, NULL, NULL);
}

static cl_int fill(gffe *g, const gffe_operation *operation) {
    const gffe_buffer *buffer = &g->plan->buffers[operation->buffer / 2];
    const cl_uchar byte = (cl_uchar)operation->other;
    size_t size[2];
    gffe_grid_size(&g->step, operation->grid, size);
    return clEnqueueFillBuffer(g->queue, g->memory[operation->buffer], &byte, 1, 0,
                               size[0] * size[1] * (size_t)buffer->bytes * (size_t)buffer->planes, 0, NULL, NULL);
}

static cl_int copy(gffe *g, const gffe_operation *operation) {
    const size_t nbytes = gffe_buffer_bytes(&g->step, &g->plan->buffers[operation->buffer / 2]);
    return clEnqueueCopyBuffer(g->queue, g->memory[operation->other], g->memory[operation->buffer], 0, 0, nbytes, 0,
                               NULL, NULL);
}

gffe_status gffe_run(gffe *g, int occasion) {
    const gffe_operations *operations = &g->plan->operations[occasion];
    const int is_new = occasion == GFFE_EXTRAPOLATED || occasion == GFFE_EXTRAPOLATED_FIRST;
    gffe_frame_block block;
    int k;
    gffe_fill_frame_block(&g->step, is_new || occasion == GFFE_COMPOSE, &block);
    for (k = 0; k < operations->count; ++k) {
        const gffe_operation *operation = &operations->list[k];
        const cl_int error = operation->kind == GFFE_LAUNCH ? launch(g, operation, &block)
                             : operation->kind == GFFE_FILL ? fill(g, operation)
                                                            : copy(g, operation);
        if (error != CL_SUCCESS)
            return gffe_checked(g, error,
                                operation->kind == GFFE_LAUNCH ? gffe_kernels[operation->kernel].name
                                                               : "filling or copying a buffer");
    }
    return GFFE_OK;
}

/* ---- events ------------------------------------------------------------------------------------------- */

gffe_status gffe_wait_for(gffe *g, cl_uint count, const cl_event *events) {
    cl_uint k;
    cl_int error;
    if (!count != !events)
        return gffe_fail(g, GFFE_INVALID, "wait_for: %u events, and %s", (unsigned)count,
                         events ? "a list of some" : "no list of them");
    for (k = 0; k < count; ++k) {
        cl_context context = NULL;
        cl_int state = CL_COMPLETE;
        if (!events[k]) return gffe_fail(g, GFFE_INVALID, "wait_for: event %u is NULL", (unsigned)k);
        error = clGetEventInfo(events[k], CL_EVENT_CONTEXT, sizeof context, &context, NULL);
        if (error != CL_SUCCESS) return gffe_checked(g, error, "asking about an event to wait for");
        if (context != g->context)
            return gffe_fail(g, GFFE_INVALID, "wait_for: event %u is of another context", (unsigned)k);
        error = clGetEventInfo(events[k], CL_EVENT_COMMAND_EXECUTION_STATUS, sizeof state, &state, NULL);
        if (error != CL_SUCCESS) return gffe_checked(g, error, "asking about an event to wait for");
        if (state < 0) /* some drivers would wait for ever */
            return gffe_fail(g, GFFE_INVALID, "wait_for: event %u has failed (OpenCL error %d)", (unsigned)k,
                             (int)state);
    }
    error = count ? clEnqueueBarrierWithWaitList(g->queue, count, events, NULL) : CL_SUCCESS;
    return gffe_checked(g, error, "waiting for events");
}

gffe_status gffe_mark(gffe *g, cl_event *done) {
    cl_int error;
    if (!done) return GFFE_OK;
    error = clEnqueueMarkerWithWaitList(g->queue, 0, NULL, done);
    if (error == CL_SUCCESS) error = clFlush(g->queue);
    return gffe_checked(g, error, "an event for finished work");
}
