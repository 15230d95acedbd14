/* Blocks of 8x8 pixels, of source and of target images (blocks.cl, warp.cl). */

#define BLOCK 8
#define SPLATTED 0   /* a target block whose pixels are won by the nearest of the fragments that are splatted there */
#define BACKWARD 1   /* one whose pixels all show one smooth surface: warped backward */

inline int blocks_along(const int side) { return (side + BLOCK - 1) / BLOCK; }
