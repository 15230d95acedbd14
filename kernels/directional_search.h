/* Looking around a hole in eight directions (hidden_parts.cl, holes.cl). */

#define DIRECTIONS 8             /* direction k + 4 is opposite to k */
#define AT_ONCE 4                /* pixels that are read at once: a march waits for memory a quarter of `reach` times at most */

INLINE int2 direction(const int k) {
    const int quarter = k & 3, sign = k < 4 ? 1 : -1;
    return (int2)(quarter == 3 ? -sign : quarter == 2 ? 0 : sign, quarter == 0 ? 0 : sign);
}

/* px per step. */
INLINE float step_length(const int2 d) { return d.x && d.y ? 1.41421356f : 1.0f; }

INLINE int room(const int at, const int direction, const int side) {
    return direction > 0 ? side - 1 - at : direction < 0 ? at : INT_MAX;
}

/* Steps from (x, y) that stay in the image and within `reach` px. */
INLINE int steps_within(const int reach, const int2 d, const int x, const int y, const int width, const int height) {
    const float step = step_length(d);
    int steps = min(min(room(x, d.x, width), room(y, d.y, height)), (int)((float)reach / step) + 1);
    while (steps > 0 && (float)steps * step > (float)reach) --steps;
    return steps;
}
