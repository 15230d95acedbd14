/* Errors of calls: status and message. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>

#include "gffe_internal.h"

gffe_status gffe_need(gffe *g, const void *argument, const char *name) {
    if (!g || !g->is_ready) return GFFE_INVALID;
    return argument ? GFFE_OK : gffe_fail(g, GFFE_INVALID, "%s must not be NULL", name);
}

gffe_status gffe_need_number(gffe *g, const char *name, double value, double low, double high) {
    if (fabs(value) < GFFE_LARGEST && value >= low && value <= high) return GFFE_OK;
    return gffe_fail(g, GFFE_INVALID, "%s must be a finite number from %g to %g, got %g", name, low, high, value);
}

gffe_status gffe_need_whole(gffe *g, const char *name, int value, int low, int high) {
    if (value >= low && value <= high) return GFFE_OK;
    return gffe_fail(g, GFFE_INVALID, "%s must be a whole number from %d to %d, got %d", name, low, high, value);
}

gffe_status gffe_fail(gffe *g, gffe_status status, const char *format, ...) {
    va_list values;
    va_start(values, format);
    vsnprintf(g->message, sizeof g->message, format, values);
    va_end(values);
    return status;
}

gffe_status gffe_checked(gffe *g, cl_int error, const char *doing) {
    const int is_memory = error == CL_MEM_OBJECT_ALLOCATION_FAILURE || error == CL_OUT_OF_RESOURCES
                          || error == CL_OUT_OF_HOST_MEMORY || error == CL_INVALID_BUFFER_SIZE;
    if (error == CL_SUCCESS) return GFFE_OK;
    return gffe_fail(g, is_memory ? GFFE_OUT_OF_MEMORY : GFFE_OPENCL, "%s: OpenCL error %d%s", doing, (int)error,
                     is_memory ? " (out of memory)" : "");
}
