/* Natural logarithm and exponential function, LANES at once: of Cephes (Moshier), without branches. Built-in functions
   differ between runtimes, and not all of them are fast. */

#include "common.h"
#include "simd.h"

/* The exponent of the power of two within sqrt(2) of x > 0. */
INLINE Ints exponent_of(const Floats x) { return (floats_as_ints(x) - 0x3f3504f3) >> 23; }

INLINE Floats mantissa_of(const Floats x, const Ints exponent) {
    return ints_as_floats(floats_as_ints(x) - (exponent << 23));
}

/* ln(mantissa * 2^exponent), to about a unit in the last place. */
INLINE Floats log_of_parts(const Floats mantissa, const Ints exponent) {
    const Floats e = to_floats(exponent), m = mantissa - 1.0f, z = m * m;
    Floats y = 7.0376836292e-2f;
    y = y * m - 1.1514610310e-1f;
    y = y * m + 1.1676998740e-1f;
    y = y * m - 1.2420140846e-1f;
    y = y * m + 1.4249322787e-1f;
    y = y * m - 1.6668057665e-1f;
    y = y * m + 2.0000714765e-1f;
    y = y * m - 2.4999993993e-1f;
    y = y * m + 3.3333331174e-1f;
    y = y * m * z - 2.12194440e-4f * e - 0.5f * z;
    return m + y + 0.693359375f * e;
}

/* ln(x) and ln(a * b) for numbers >= 1 and below 1e28; the product may be too large for a float. */
#define SCALED 60 /* powers of two by which it is made smaller */
INLINE Floats log_of(const Floats x) {
    const Ints exponent = exponent_of(x);
    return log_of_parts(mantissa_of(x, exponent), exponent);
}

INLINE Floats log_of_product(const Floats a, const Floats b) {
    const Floats product = a * ints_as_floats((Ints)((127 - SCALED) << 23)) * b;
    const Ints exponent = exponent_of(product);
    return log_of_parts(mantissa_of(product, exponent), exponent + SCALED);
}

/* exp(x) - 1 for x from -87 to 88, with the same precision where x is not negative. */
INLINE Floats exp_less_one(const Floats x) {
    const Floats n = floor(x * 1.44269504088896341f + 0.5f);
    const Floats r = x - n * 0.693359375f + n * 2.12194440e-4f;
    Floats y = 1.9875691500e-4f;
    y = y * r + 1.3981999507e-3f;
    y = y * r + 8.3334519073e-3f;
    y = y * r + 4.1665795894e-2f;
    y = y * r + 1.6666665459e-1f;
    y = y * r + 5.0000001201e-1f;
    y = y * r * r + r;
    const Floats power = ints_as_floats((to_ints(n) + 127) << 23);
    return y * power + (power - 1.0f);
}
