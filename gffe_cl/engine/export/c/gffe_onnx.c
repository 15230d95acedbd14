#include "gffe_onnx.h"

#include <onnxruntime_c_api.h>
#include <stdio.h>
#include <stdlib.h>

enum { INPUT_PLANES = 8, CANDIDATE_PLANES = 16, JUDGEMENT_PLANES = 20 };

struct gffe_onnx {
    const OrtApi *api;
    OrtEnv *env;
    OrtSession *session;
    OrtMemoryInfo *memory;
};

/* Returns whether a call succeeded; prints an error on stderr if not. */
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
    good = went_well(n, n->api->CreateEnv(ORT_LOGGING_LEVEL_ERROR, "gffe", &n->env))
           && went_well(n, n->api->DisableTelemetryEvents(n->env))
           && went_well(n, n->api->CreateSessionOptions(&options))
           && went_well(n, n->api->CreateCpuMemoryInfo(OrtArenaAllocator, OrtMemTypeDefault, &n->memory))
           && went_well(n, n->api->CreateSession(n->env, path, options, &n->session));
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

/* Makes a tensor of images over existing memory. */
static OrtValue *planes(const gffe_onnx *n, void *memory, int64_t count, int64_t width, int64_t height) {
    const int64_t shape[] = {1, count, height, width};
    const size_t nbytes = sizeof(float) * (size_t)(count * height * width);
    OrtValue *made = NULL;
    if (!went_well(n, n->api->CreateTensorWithDataAsOrtValue(n->memory, memory, nbytes, shape, 4,
                                                             ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT, &made)))
        return NULL;
    return made;
}

static int run_session(const gffe_onnx *n, void *frames, void *candidates, void *judgement, int64_t width,
                       int64_t height) {
    static const char *const inputs[] = {"frames", "candidates"};
    static const char *const outputs[] = {"judgement"};
    OrtValue *given[2], *made;
    int good, k;
    given[0] = planes(n, frames, INPUT_PLANES, width, height);
    given[1] = planes(n, candidates, CANDIDATE_PLANES, width / 2, height / 2);
    made = planes(n, judgement, JUDGEMENT_PLANES, width / 2, height / 2);
    good = given[0] && given[1] && made
           && went_well(n, n->api->Run(n->session, NULL, inputs, (const OrtValue *const *)given, 2, outputs, 1, &made));
    for (k = 0; k < 2; ++k)
        if (given[k]) n->api->ReleaseValue(given[k]);
    if (made) n->api->ReleaseValue(made);
    return good;
}

/* Where host and device share memory nothing is copied; else the driver copies once: here, or when it is unmapped if
   the host writes. */
static void *map(cl_command_queue queue, cl_mem buffer, cl_map_flags flags, size_t nbytes) {
    return clEnqueueMapBuffer(queue, buffer, CL_TRUE, flags, 0, nbytes, 0, NULL, NULL, NULL);
}

int gffe_onnx_run(void *network, cl_command_queue queue, cl_mem frames, cl_mem candidates, cl_mem judgement,
                  size_t width, size_t height) {
    const size_t plane = width * height * sizeof(float);
    const cl_mem buffers[] = {frames, candidates, judgement};
    void *at[3];
    int good, k;
    if (!network || !queue || !frames || !candidates || !judgement) return 1;
    at[0] = map(queue, frames, CL_MAP_READ, INPUT_PLANES * plane);
    at[1] = map(queue, candidates, CL_MAP_READ, CANDIDATE_PLANES * plane / 4);
    at[2] = map(queue, judgement, CL_MAP_WRITE_INVALIDATE_REGION, JUDGEMENT_PLANES * plane / 4);
    good = at[0] && at[1] && at[2]
           && run_session((const gffe_onnx *)network, at[0], at[1], at[2], (int64_t)width, (int64_t)height);
    for (k = 0; k < 3; ++k)
        if (at[k]) clEnqueueUnmapMemObject(queue, buffers[k], at[k], 0, NULL, NULL);
    return good ? 0 : 1;
}
