/* Built-in functions of OpenCL C for NVIDIA's GPUs that libclc lacks, or writes worse than NVIDIA's own compiler (vendor_compilers.py). */

/* libclc 19 has no minimum of 64 bits for a volatile pointer. */
ulong __attribute__((overloadable)) atom_min(volatile __global ulong *p, ulong x) {
    return __atomic_fetch_min(p, x, __ATOMIC_RELAXED);
}

/* One conversion for each number; libclc computes with integers. */
#pragma OPENCL EXTENSION cl_khr_fp16 : enable
void __attribute__((overloadable)) vstore_half_rte(float x, ulong i, __global half *p) { p[i] = (half)x; }
void __attribute__((overloadable)) vstore_half4_rte(float4 x, ulong i, __global half *p) {
    *(__global half4 *)(p + 4 * i) = __builtin_convertvector(x, half4);
}
void __attribute__((overloadable)) vstore_half4_rte(float4 x, ulong i, half *p) {
    *(half4 *)(p + 4 * i) = __builtin_convertvector(x, half4);
}
void __attribute__((overloadable)) vstore_half8_rte(float8 x, ulong i, __global half *p) {
    *(__global half8 *)(p + 8 * i) = __builtin_convertvector(x, half8);
}
void __attribute__((overloadable)) vstore_half16_rte(float16 x, ulong i, __global half *p) {
    *(__global half16 *)(p + 16 * i) = __builtin_convertvector(x, half16);
}
