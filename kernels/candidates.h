/* Shared by shading_flow.cl, which makes these, and correction.cl, which reads them, too. Channels of the shading
 * correction network's candidates: */

#define FOUND 0 /* first of two channels: the flow from the extrapolated frame into the warped previous one, in ... */
#define FOUND_UNIT 4.0f /* ... pixels of a quarter of the resolution */
#define HELD 13 /* channel: how far the last interval's trend was that of the interval before */
#define LEAST 0.000001f /* squared difference of encoded color */
