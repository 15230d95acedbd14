/* The shading correction network with ONNX Runtime's C API: optional, compiled only where that is installed. */
#ifndef GFFE_ONNX_H
#define GFFE_ONNX_H

#include "gffe.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct gffe_onnx gffe_onnx;

/* Opens the model (scn.onnx) on the CPU; NULL where that fails, after a line on stderr. (ONNX Runtime
   wants wide characters on Windows: change `path` there.) */
gffe_onnx *gffe_onnx_open(const char *path);

void gffe_onnx_close(gffe_onnx *network);

/* Callback for gffe_options: options.network = gffe_onnx_run; options.network_user = network. */
int gffe_onnx_run(void *network, cl_command_queue queue, cl_mem frames, cl_mem candidates, cl_mem judgement,
                  size_t width, size_t height);

#ifdef __cplusplus
}
#endif
#endif
