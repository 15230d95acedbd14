/* Channels of the shading correction network's candidates, which shading_flow.cl makes, that correction.cl reads too. */

#define FOUND 0          /* first of two channels: the flow from the extrapolated frame into the warped previous one, in ... */
#define FOUND_UNIT 4.0f  /* ... pixels of a quarter of the resolution */
#define HELD 13          /* channel: how far the last interval's trend was that of the interval before */
