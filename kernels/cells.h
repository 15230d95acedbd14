/* Cells of 4x4 pixels of a rendered frame, in which one mover's velocity and acceleration are known (see acceleration.cl). */

#define CELL 4                 /* px each way */
#define CELL_TOLERANCE 0.05f   /* relative depth within which a fragment, or another cell, belongs to the cell's mover */

inline int cell_of(const int x, const int y, const int width) { return y / CELL * ((width + CELL - 1) / CELL) + x / CELL; }

inline bool is_of_cell(const float z, const float cell_depth) { return fabs(z - cell_depth) <= CELL_TOLERANCE * cell_depth; }
