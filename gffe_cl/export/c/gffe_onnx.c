#include "gffe_onnx.h"

#include <onnxruntime_c_api.h>
#include <stdio.h>
#include <stdlib.h>

enum { INPUT_PLANES = 8, OUTPUT_PLANES = 5 };

struct gffe_onnx {
    const OrtApi *api;
    OrtEnv *env;
    OrtSession *session;
    OrtMemoryInfo *memory;
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
    if (!n) return NULL;
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
           went_well(n, n->api->CreateSession(n->env, path, options, &n->session));
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

static int run_session(const gffe_onnx *n, void *frames, float alpha, void *correction, int64_t width, int64_t height) {
    static const char *const inputs[] = {"frames", "alpha"};
    static const char *const outputs[] = {"correction"};
    int64_t frames_shape[4], correction_shape[4];
    const int64_t one = 1;
    OrtValue *given[2], *made;
    int good;
    frames_shape[0] = correction_shape[0] = 1;
    frames_shape[1] = INPUT_PLANES;
    correction_shape[1] = OUTPUT_PLANES;
    frames_shape[2] = correction_shape[2] = height;
    frames_shape[3] = correction_shape[3] = width;
    given[0] = tensor(n, frames, frames_shape, 4);
    given[1] = tensor(n, &alpha, &one, 1);
    made = tensor(n, correction, correction_shape, 4);
    good = given[0] && given[1] && made &&
           went_well(n, n->api->Run(n->session, NULL, inputs, (const OrtValue *const *)given, 2, outputs, 1, &made));
    if (given[0]) n->api->ReleaseValue(given[0]);
    if (given[1]) n->api->ReleaseValue(given[1]);
    if (made) n->api->ReleaseValue(made);
    return good;
}

int gffe_onnx_run(void *network, cl_command_queue queue, cl_mem frames, cl_mem correction, size_t width, size_t height,
                  float alpha) {
    const size_t plane = width * height * sizeof(float);
    void *input, *output;
    int good;
    input = clEnqueueMapBuffer(queue, frames, CL_TRUE, CL_MAP_READ, 0, INPUT_PLANES * plane, 0, NULL, NULL, NULL);
    output = clEnqueueMapBuffer(queue, correction, CL_TRUE, CL_MAP_WRITE_INVALIDATE_REGION, 0, OUTPUT_PLANES * plane, 0,
                                NULL, NULL, NULL);
    good = input && output &&
           run_session((const gffe_onnx *)network, input, alpha, output, (int64_t)width, (int64_t)height);
    if (input) clEnqueueUnmapMemObject(queue, frames, input, 0, NULL, NULL);
    if (output) clEnqueueUnmapMemObject(queue, correction, output, 0, NULL, NULL);
    return good ? 0 : 1;
}
