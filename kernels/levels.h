/* States of the texels of background levels (background.cl, connectivity.cl). */

#define EMPTY 0
#define SHOWN 1        /* of level 0: a static fragment of the frame itself: the warp projects it */
#define REMEMBERED 2   /* of an earlier frame */
