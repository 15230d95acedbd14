/* Writing the frame block to the device. Arguments of a kernel are copied when it is enqueued: so the host needs no
   memory that lasts until then, and waits for nothing. */

#include "frame.h"

__kernel void set_frame(const Frame given, __global Frame *frame) { *frame = given; }
