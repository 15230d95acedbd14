/* Lines at the image's border, which go on beyond it: found by the warp (warp.cl), continued by holes.cl. */

#include "frame.h"
#include "color_code.h"

#define CELL 8 /* px each way, of the grid "cells" */
#define LINE_STRIDE 2 /* px between its samples */

/* Sums over samples of a cell: products of the changes of color codes in x and y (the structure tensor). */
INLINE void find_lines(const int cell_x, const int cell_y, __constant Frame *frame, __global const half *codes,
                       __global float *border_lines) {
    const int width = frame->source_width, height = frame->source_height;
    const int first_x = max(min(cell_x * CELL, width - CELL), 0) + 1,
              first_y = max(min(cell_y * CELL, height - CELL), 0) + 1;
    float xx = 0.0f, xy = 0.0f, yy = 0.0f;
    for (int y = first_y; y < min(first_y + CELL - 1, height - 1); y += LINE_STRIDE)
        for (int x = first_x; x < min(first_x + CELL - 1, width - 1); x += LINE_STRIDE) {
            const int src = y * width + x;
            const float3 dx = 0.5f * (stored_code(codes, src + 1) - stored_code(codes, src - 1));
            const float3 dy = 0.5f * (stored_code(codes, src + width) - stored_code(codes, src - width));
            xx += squared_length(dx);
            xy += product_of(dx, dy);
            yy += squared_length(dy);
        }
    const int cell = cell_y * frame->cells_width + cell_x, plane = frame->cells_width * frame->cells_height;
    border_lines[cell] = xx;
    border_lines[plane + cell] = xy;
    border_lines[2 * plane + cell] = yy;
}

/* The cells at the image's border that are those of work-item `item` of `items`: of the first and last row, then of the
   first and last column. */
INLINE void find_border_lines(const int item, const int items, __constant Frame *frame, __global const half *codes,
                              __global float *border_lines) {
    const int width = frame->cells_width, height = frame->cells_height;
    for (int k = item; k < 2 * (width + max(height - 2, 0)); k += items) {
        const int along = k >> 1, is_last = k & 1;
        const bool in_row = along < width;
        const int cell_x = in_row ? along : is_last * (width - 1);
        const int cell_y = in_row ? is_last * (height - 1) : along - width + 1;
        find_lines(cell_x, cell_y, frame, codes, border_lines);
    }
}
