/* Builds a program of OpenCL C with AMD's own OpenCL runtime for a GPU that is not there: rocm_offline GPU OPTIONS FILE.
   gpu_compilers.py compiles it into the folder where that runtime lies. The runtime is loaded by name, so nothing is linked. */

#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void *Handle;

enum { DEVICE_NAME = 0x102B, CONTEXT_DEVICES = 0x1081, CONTEXT_PLATFORM = 0x1084, BUILD_LOG = 0x1183, OFFLINE_DEVICES = 0x403F };

static char source[1 << 22], text[1 << 16];

static void *library;

static void *function(const char *name) {
    void *found = dlsym(library, name);
    if (!found) { fprintf(stderr, "no %s in libOpenCL.so.1\n", name); exit(2); }
    return found;
}

static void check(int failed, const char *what, int error) {
    if (failed) { fprintf(stderr, "%s (%d)\n", what, error); exit(2); }
}

int main(int count, char **arguments) {
    check(count != 4, "rocm_offline GPU OPTIONS FILE", count);
    library = dlopen("libOpenCL.so.1", RTLD_NOW);
    check(!library, "there is no libOpenCL.so.1", 0);
    int32_t (*get_platforms)(uint32_t, Handle *, uint32_t *) = function("clGetPlatformIDs");
    Handle (*create_context)(intptr_t *, uint64_t, void *, void *, int32_t *) = function("clCreateContextFromType");
    int32_t (*get_context)(Handle, uint32_t, size_t, void *, size_t *) = function("clGetContextInfo");
    int32_t (*get_device)(Handle, uint32_t, size_t, void *, size_t *) = function("clGetDeviceInfo");
    Handle (*create_program)(Handle, uint32_t, const char **, size_t *, int32_t *) = function("clCreateProgramWithSource");
    int32_t (*build)(Handle, uint32_t, Handle *, const char *, void *, void *) = function("clBuildProgram");
    int32_t (*get_build)(Handle, Handle, uint32_t, size_t, void *, size_t *) = function("clGetProgramBuildInfo");

    Handle platform, devices[256], device = NULL;
    uint32_t platforms = 0;
    int32_t error = get_platforms(1, &platform, &platforms);
    check(!platforms, "AMD's runtime does not load", error);
    intptr_t properties[] = {CONTEXT_PLATFORM, (intptr_t)platform, OFFLINE_DEVICES, 1, 0};
    Handle context = create_context(properties, 0xFFFFFFFF, NULL, NULL, &error);
    check(!context, "no context of devices that are not there", error);
    size_t bytes = 0;
    get_context(context, CONTEXT_DEVICES, sizeof devices, devices, &bytes);
    for (size_t k = 0; k < bytes / sizeof(Handle); k++) {
        get_device(devices[k], DEVICE_NAME, sizeof text, text, NULL);
        if (!strcmp(text, arguments[1])) device = devices[k];
    }
    check(!device, "the runtime does not know this GPU", 0);

    FILE *file = fopen(arguments[3], "rb");
    check(!file, "cannot read the program", 0);
    source[fread(source, 1, sizeof source - 1, file)] = 0;
    const char *program_text = source;
    Handle program = create_program(context, 1, &program_text, NULL, &error);
    error = build(program, 1, &device, arguments[2], NULL, NULL);
    get_build(program, device, BUILD_LOG, sizeof text - 1, text, NULL);
    check(error != 0, text, error);
    return 0;
}
