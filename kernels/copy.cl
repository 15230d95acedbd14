/* Copies for measuring bandwidth (gffe bench). */

__kernel void copy_scalar(__global const float *from, __global float *to) {
    const size_t i = get_global_id(0);
    to[i] = from[i];
}

__kernel void copy_vector(__global const float4 *from, __global float4 *to) {
    const size_t i = get_global_id(0);
    to[i] = from[i];
}

/* A run of consecutive vectors per work-item: fastest on CPUs. */
__kernel void copy_run(__global const float16 *from, __global float16 *to, const int run) {
    const size_t first = get_global_id(0) * (size_t)run;
    for (int k = 0; k < run; ++k) to[first + k] = from[first + k];
}
