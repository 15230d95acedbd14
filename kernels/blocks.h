/* Blocks of 8x4 pixels, of source and of target images (backward_blocks.cl, warp.cl). */

#define BLOCK_WIDTH 8
#define BLOCK_HEIGHT 4
#define SPLATTED 0   /* a target block whose pixels are won by the nearest of the fragments that are splatted there */
#define BACKWARD 1   /* one whose pixels' sources are found by the inverse of the block's flow: warped backward */
#define COPIED 2     /* one that nothing but the rendered frame's own pixels reach, which stay: they are copied */

/* Of a source block over which positions are linear; and of one whose pixels stay, and all within STIR_REACH, perhaps
   at the image's border. */
#define SMOOTH 1
#define RESTING 2

INLINE int block_columns(const int width) { return (width + BLOCK_WIDTH - 1) / BLOCK_WIDTH; }
INLINE int block_rows(const int height) { return (height + BLOCK_HEIGHT - 1) / BLOCK_HEIGHT; }

/* Index of the block of pixel (x, y). */
INLINE int block_of(const int x, const int y, const int width) {
    return y / BLOCK_HEIGHT * block_columns(width) + x / BLOCK_WIDTH;
}

/* ---- while a camera rests --------------------------------------------------------------------------------------- */

#define STIR_REACH 2 /* px: as far as kernels that skip blocks look around a pixel */

/* For how many rendered frames nothing has stirred within STIR_REACH of a block; 0: something does in this one. All
   that is skipped while a camera rests is decided here. `last_stir`: the number of the frame in which something did
   last, by blocks (history.cl). */
INLINE int calm_frames(const int block, __constant Frame *frame, __global const int *last_stir) {
    return frame->number - last_stir[block];
}

/* Whether its pixels stay where they are from the rendered frame to the new one. */
INLINE bool stays_put(const int block, __constant Frame *frame, __global const int *last_stir) {
    return frame->stays && calm_frames(block, frame, last_stir) > 0;
}

/* Whether all of what the frame before showed there, and this one, is the same: no fragment comes into its background
   or is hidden. */
INLINE bool collects_nothing(const int block, __constant Frame *frame, __global const int *last_stir) {
    return frame->rests && calm_frames(block, frame, last_stir) > 1;
}

/* Whether its links, and the state of its texels, are what they were in the last two frames, in which they were found
   alike: the memory of both is that of the frame before the last. */
INLINE bool links_are_known(const int block, __constant Frame *frame, __global const int *last_stir) {
    return frame->rests >= 3 && calm_frames(block, frame, last_stir) > 2;
}
