/* The law by which color is encoded for the shading correction network (paper: 'Shading Correction Network'), LANES
   at once. */

#include "logarithm.h"

/* mu-law of color: 1 at three stops above display white, no upper limit. `law`: mu * exposure / 8, 1 / ln(1 + mu), and
   their reciprocals. NaN is 0. */
#define LIFTED(type, c, law)                                                                                           \
    (1.0f + (law).x * ((c) > 0.0f ? ((c) < COLOR_MAX ? (c) : (type)(COLOR_MAX)) : (type)(0.0f)))

INLINE Floats lifted(const Floats c, const float4 law) { return LIFTED(Floats, c, law); }

INLINE Floats encode(const Floats c, const float4 law) { return log_of(lifted(c, law)) * law.y; }

INLINE Floats decode(const Floats e, const float4 law) {
    return wide_lesser(exp_less_one(wide_lesser(wide_greater(e, (Floats)(0.0f)) * law.w, (Floats)(88.0f))) * law.z,
                       (Floats)(COLOR_MAX));
}
