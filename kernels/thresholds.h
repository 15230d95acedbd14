/* Thresholds that several files share. A constant has one value in all kernels (tests/test_house.py). What set
   them: docs/deviations.md, "The surface met at x' is checked", "Dilated vectors are undone". */

/* Relative depth within which a surface, seen in another frame, or by another sample of the same one, is the same: 2%
   lose up to 0.03 dB, 1.5% 0.08, 5% gain up to 0.05 on one situation. */
#define SAME_SURFACE 0.03f
#define NEARER 0.97f /* times the depth of a surface: what is nearer is another one; the other side of these 3% */
#define DEPTH_PER_MOTION 2.0f /* the addition to a tolerance of depth per unit of a surface's sideways motion */
