/* Placement of buffers on the device. Buffers that hold something only while a frame is extrapolated lie in memory that
   is free then, several in one place if no stage works with more than one of them, as in Python's Board. */
#include <stdlib.h>
#include <string.h>

#include "gffe_internal.h"

enum { SPARES = 8 }; /* times the alignment: lent memory beyond its parts */

static int is_transient(const gffe_buffer *buffer) { return buffer->first >= 0; }

/* Places parts side by side in the memory that contains them, and sets its size. */
static void place_parts(gffe *g) {
    int number, part;
    for (number = 0; number < g->plan->buffer_count; ++number) {
        const gffe_buffer *buffer = &g->plan->buffers[number];
        gffe_place *place = &g->places[number];
        place->root = -1;
        place->start = 0;
        place->bytes = buffer->flags & GFFE_MEMORY ? 0 : gffe_buffer_bytes(&g->step, buffer);
    }
    for (part = 0; part < g->plan->buffer_count; ++part) { /* wholes come before their parts */
        const gffe_buffer *buffer = &g->plan->buffers[part];
        gffe_place *place = &g->places[part], *whole;
        if (buffer->whole < 0) continue;
        whole = &g->places[buffer->whole];
        place->root = whole->root >= 0 ? whole->root : 2 * buffer->whole;
        if (g->plan->buffers[buffer->whole].flags & GFFE_MEMORY) {
            place->start = whole->bytes ? gffe_aligned(&g->step, whole->bytes + 1) : 0;
            whole->bytes = place->start + place->bytes;
        } else {
            place->start = whole->start + gffe_level_start(&g->step, buffer->level) * (size_t)buffer->bytes;
        }
    }
    for (number = 0; number < g->plan->buffer_count; ++number)
        if (g->plan->buffers[number].flags & (GFFE_LENT | GFFE_LENT_BEFORE))
            g->places[number].bytes += SPARES * g->step.alignment;
}

static int at_one_time(const gffe_buffer *a, const gffe_buffer *b) {
    return a->first <= b->last && b->first <= a->last;
}

/* Returns the first byte of the memory `root` from which on the transient buffer `number` fits beside those that are
   there already. */
static size_t free_start(const gffe *g, int root, int number) {
    const gffe_buffer *buffer = &g->plan->buffers[number];
    const size_t nbytes = g->places[number].bytes;
    size_t start = 0;
    int k, moved = 1;
    while (moved) {
        moved = 0;
        for (k = 0; k < g->plan->buffer_count; ++k) {
            const gffe_place *other = &g->places[k];
            const size_t end = gffe_aligned(&g->step, other->start + other->bytes + 1);
            if (!is_transient(&g->plan->buffers[k]) || other->root != root
                || !at_one_time(buffer, &g->plan->buffers[k]))
                continue;
            if (start < end && other->start < start + nbytes) {
                start = end;
                moved = 1;
            }
        }
    }
    return start;
}

/* Finds a place in lent memory for a transient buffer; without one it keeps memory of its own. */
static void place_transient(gffe *g, int number) {
    int k;
    for (k = 0; k < g->plan->buffer_count; ++k) {
        const int flags = g->plan->buffers[k].flags;
        const int root = 2 * k + (flags & GFFE_LENT_BEFORE ? 1 : 0);
        size_t start;
        if (!(flags & (GFFE_LENT | GFFE_LENT_BEFORE))) continue;
        start = free_start(g, root, number);
        if (start + g->places[number].bytes <= g->places[k].bytes) {
            g->places[number].root = root;
            g->places[number].start = start;
            return;
        }
    }
}

/* Creates a buffer with memory of its own, all of whose bytes are `byte`. */
static cl_int create(gffe *g, int byte, size_t nbytes, cl_mem *made) {
    const cl_uchar filled = (cl_uchar)byte;
    cl_int error;
    *made = clCreateBuffer(g->context, CL_MEM_READ_WRITE, nbytes, NULL, &error);
    return *made ? clEnqueueFillBuffer(g->queue, *made, &filled, 1, 0, nbytes, 0, NULL, NULL) : error;
}

/* Creates a part of a buffer. A reference is kept in `parts`: NVIDIA's driver (580.159) crashes unless parts that
   overlap are released in the reverse of the order in which they were made. */
static cl_int create_part(gffe *g, const gffe_place *place, int root, cl_mem *made) {
    cl_buffer_region region;
    cl_int error;
    region.origin = place->start;
    region.size = place->bytes;
    *made = clCreateSubBuffer(g->memory[root], CL_MEM_READ_WRITE, CL_BUFFER_CREATE_TYPE_REGION, &region, &error);
    if (*made && clRetainMemObject(*made) == CL_SUCCESS) g->parts[g->part_count++] = *made;
    return error;
}

/* Returns whether there are two of a buffer, which change places with every frame: it is kept, or it lies in such
   memory. */
static int is_double(const gffe *g, int number) {
    const int root = g->places[number].root;
    return g->plan->buffers[number].flags & GFFE_KEPT
           || (is_transient(&g->plan->buffers[number]) && root >= 0 && g->plan->buffers[root / 2].flags & GFFE_KEPT);
}

gffe_status gffe_allocate(gffe *g, int late) {
    int number, parts, k;
    if (!late) {
        place_parts(g);
        for (number = 0; number < g->plan->buffer_count; ++number) /* mostly, large ones come first */
            if (is_transient(&g->plan->buffers[number])) place_transient(g, number);
    }
    for (parts = 0; parts < 2; ++parts) /* first the containers of others */
        for (number = 0; number < g->plan->buffer_count; ++number) {
            const gffe_buffer *buffer = &g->plan->buffers[number];
            const gffe_place *place = &g->places[number];
            if (buffer->flags & GFFE_GIVEN
                || late != (buffer->flags & (GFFE_LATE | GFFE_OF_OVERLAYS | GFFE_OF_FORMATS)))
                continue;
            if ((place->root >= 0) != parts || !place->bytes) continue;
            for (k = 0; k < (is_double(g, number) ? 2 : 1); ++k) {
                cl_mem *made = &g->memory[2 * number + k];
                const cl_int error =
                    parts ? create_part(g, place, place->root ^ k, made) : create(g, buffer->byte, place->bytes, made);
                if (error != CL_SUCCESS) return gffe_checked(g, error, buffer->name);
            }
        }
    return GFFE_OK;
}

gffe_status gffe_check_buffer(gffe *g, cl_mem buffer, const char *name, int reference) {
    const gffe_buffer *like = &g->plan->buffers[reference / 2];
    size_t sides[2];
    int size[2];
    gffe_grid_size(&g->step, like->grid, sides);
    size[0] = (int)sides[0];
    size[1] = (int)sides[1];
    return gffe_check_bytes(g, buffer, name, size, (size_t)like->bytes);
}

gffe_status gffe_check_bytes(gffe *g, cl_mem buffer, const char *name, const int sides[2], size_t texel) {
    const size_t wanted = texel * (size_t)sides[0] * (size_t)sides[1];
    size_t size = 0;
    cl_context context = NULL;
    cl_mem_object_type type = CL_MEM_OBJECT_BUFFER;
    cl_int error;
    if (!buffer) return gffe_fail(g, GFFE_INVALID, "frame: there is no %s buffer", name);
    error = clGetMemObjectInfo(buffer, CL_MEM_TYPE, sizeof type, &type, NULL);
    if (error == CL_SUCCESS) error = clGetMemObjectInfo(buffer, CL_MEM_SIZE, sizeof size, &size, NULL);
    if (error == CL_SUCCESS) error = clGetMemObjectInfo(buffer, CL_MEM_CONTEXT, sizeof context, &context, NULL);
    if (error != CL_SUCCESS) return gffe_checked(g, error, name);
    if (type != CL_MEM_OBJECT_BUFFER)
        return gffe_fail(g, GFFE_INVALID, "frame: %s is an image (expected a buffer: clEnqueueCopyImageToBuffer)",
                         name);
    if (size < wanted)
        return gffe_fail(g, GFFE_INVALID, "frame: %s buffer must hold %lu bytes (%dx%d), got %lu", name,
                         (unsigned long)wanted, sides[0], sides[1], (unsigned long)size);
    if (context != g->context) return gffe_fail(g, GFFE_INVALID, "frame: %s buffer is of another context", name);
    return GFFE_OK;
}

int gffe_reference(const gffe *g, const char *name) {
    const size_t length = strlen(name);
    const int kept = length && name[length - 1] == '\'';
    int k;
    for (k = 0; k < g->plan->buffer_count; ++k) {
        const char *own = g->plan->buffers[k].name;
        if (strlen(own) == length - (size_t)kept && !strncmp(own, name, length - (size_t)kept))
            return !kept || g->plan->buffers[k].flags & GFFE_KEPT ? 2 * k + kept : -1;
    }
    return -1;
}

void gffe_swap(gffe *g, int overlays) {
    int k;
    for (k = 0; k < g->plan->buffer_count; ++k)
        if (is_double(g, k) && (g->plan->buffers[k].flags & GFFE_OF_OVERLAYS) == overlays) {
            const cl_mem made = g->memory[2 * k];
            g->memory[2 * k] = g->memory[2 * k + 1];
            g->memory[2 * k + 1] = made;
        }
}
