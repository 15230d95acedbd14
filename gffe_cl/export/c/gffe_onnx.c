#include "gffe_onnx.h"

#include <onnxruntime_c_api.h>
#include <stdio.h>
#include <stdlib.h>

enum { INPUT_PLANES = 8, TREND_PLANES = 7, OUTPUT_PLANES = 5 };

struct gffe_onnx {
    const OrtApi *api;
    OrtEnv *env;
    OrtSession *session;
    OrtMemoryInfo *memory;
    size_t inputs; /* 2, or 3 with trends */
};

/* Whether a call went well; says on stderr if it did not. */
static int went_well(const gffe_onnx *n, OrtStatus *status) {
    if (!status) return 1;
    fprintf(stderr, "gffe_onnx: %s\n", n->api->GetErrorMessage(status));
    n->api->ReleaseStatus(status);
    return 0;
}

gffe_onnx *gffe_onnx_open(const char *path) {
    gffe_onnx *n = (gffe_onnx *)calloc(1, sizeof *n);
    OrtSessionOptions *options = NULL;
    int good;
    if (!n || !path) {
        free(n);
        return NULL;
    }
    n->api = OrtGetApiBase()->GetApi(ORT_API_VERSION);
    if (!n->api) {
        fprintf(stderr, "gffe_onnx: the library is older than its header\n");
        free(n);
        return NULL;
    }
    good = went_well(n, n->api->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "gffe", &n->env)) &&
           went_well(n, n->api->DisableTelemetryEvents(n->env)) &&
           went_well(n, n->api->CreateSessionOptions(&options)) &&
           went_well(n, n->api->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &n->memory)) &&
           went_well(n, n->api->CreateSession(n->env, path, options, &n->session)) &&
           went_well(n, n->api->SessionGetInputCount(n->session, &n->inputs));
    if (options) n->api->ReleaseSessionOptions(options);
    if (good) return n;
    gffe_onnx_close(n);
    return NULL;
}

void gffe_onnx_close(gffe_onnx *n) {
    if (!n) return;
    if (n->session) n->api->ReleaseSession(n->session);
    if (n->memory) n->api->ReleaseMemoryInfo(n->memory);
    if (n->env) n->api->ReleaseEnv(n->env);
    free(n);
}

/* A tensor over memory that is there already. */
static OrtValue *tensor(const gffe_onnx *n, void *memory, const int64_t *shape, size_t rank) {
    OrtValue *made = NULL;
    size_t nbytes = sizeof(float), k;
    for (k = 0; k < rank; ++k) nbytes *= (size_t)shape[k];
    if (!went_well(n, n->api->CreateTensorWithDataAsOrtValue(n->memory, memory, nbytes, shape, rank,
                                                             ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, &made)))
        return NULL;
    return made;
}

static OrtValue *planes(const gffe_onnx *n, void *memory, int64_t count, int64_t width, int64_t height) {
    int64_t shape[4];
    shape[0] = 1;
    shape[1] = count;
    shape[2] = height;
    shape[3] = width;
    return tensor(n, memory, shape, 4);
}

static int run_session(const gffe_onnx *n, void *frames, void *trends, float alpha, void *correction, int64_t width,
                       int64_t height) {
    static const char *const inputs[] = {"frames", "alpha", "trends"};
    static const char *const outputs[] = {"correction"};
    const int64_t one = 1;
    OrtValue *given[3], *made;
    int good, k;
    given[0] = planes(n, frames, INPUT_PLANES, width, height);
    given[1] = tensor(n, &alpha, &one, 1);
    given[2] = planes(n, trends, TREND_PLANES, width, height);
    made = planes(n, correction, OUTPUT_PLANES, width, height);
    good = given[0] && given[1] && given[2] && made &&
           went_well(n, n->api->Run(n->session, NULL, inputs, (const OrtValue *const *)given, n->inputs < 3 ? 2 : 3,
                                    outputs, 1, &made));
    for (k = 0; k < 3; ++k)
        if (given[k]) n->api->ReleaseValue(given[k]);
    if (made) n->api->ReleaseValue(made);
    return good;
}

static void *map(cl_command_queue queue, cl_mem buffer, cl_map_flags flags, size_t nbytes) {
    return clEnqueueMapBuffer(queue, buffer, CL_TRUE, flags, 0, nbytes, 0, NULL, NULL, NULL);
}

int gffe_onnx_run(void *network, cl_command_queue queue, cl_mem frames, cl_mem trends, cl_mem correction, size_t width,
                  size_t height, float alpha) {
    const size_t plane = width * height * sizeof(float);
    const cl_mem buffers[] = {frames, trends, correction};
    void *at[3];
    int good, k;
    if (!network || !queue || !frames || !trends || !correction) return 1;
    at[0] = map(queue, frames, CL_MAP_READ, INPUT_PLANES * plane);
    at[1] = map(queue, trends, CL_MAP_READ, TREND_PLANES * plane);
    at[2] = map(queue, correction, CL_MAP_WRITE_INVALIDATE_REGION, OUTPUT_PLANES * plane);
    good = at[0] && at[1] && at[2] &&
           run_session((const gffe_onnx *)network, at[0], at[1], alpha, at[2], (int64_t)width, (int64_t)height);
    for (k = 0; k < 3; ++k)
        if (at[k]) clEnqueueUnmapMemObject(queue, buffers[k], at[k], 0, NULL, NULL);
    return good ? 0 : 1;
}
