/* Pacing: which frame to show at a refresh. The same decisions as gffe_cl/engine/pipeline/pacing.py, in the same order
   of operations. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "gffe.h"

#define STALLED 4.0       /* times 1/fps: what takes longer is a stall */
#define SAME 1e-3         /* of a refresh: times closer than that are one */
#define LEAST_ALPHA 1e-6
#define FAR_ALPHA 16.0
#define MOST_SECONDS 1e12 /* of a clock */

static int is_within(double value, double low, double high) { return value >= low && value <= high; }

/* ---- the last values of a kind ------------------------------------------------------------------------- */

static void append(double *values, int room, int *count, double value) {
    const int kept = *count < room ? *count : room - 1;
    memmove(values + 1, values, sizeof *values * (size_t)kept);
    values[0] = value;
    *count = kept + 1;
}

static double least(const double *values, int count, double otherwise) {
    double found = count ? values[0] : otherwise;
    int k;
    for (k = 1; k < count; ++k) found = values[k] < found ? values[k] : found;
    return found;
}

#define APPEND(pacer, name, value)                                                                                     \
    append((pacer)->name, (int)(sizeof(pacer)->name / sizeof(double)), &(pacer)->name##_count, value)
#define LEAST(pacer, name, otherwise) least((pacer)->name, (pacer)->name##_count, otherwise)

/* ---- usual times --------------------------------------------------------------------------------------- */

/* Returns the seconds between the last two frames, `before` frames ago. */
static double interval_of(const gffe_pacer *p, int before) {
    return p->times_count > before + 1 ? p->times[before] - p->times[before + 1] : 1.0 / p->fps;
}

static double usual_interval(const gffe_pacer *p) {
    return fmin(fmin(interval_of(p, 0), interval_of(p, 1)), STALLED / p->fps);
}

static double usual_making(const gffe_pacer *p) {
    const double interval = usual_interval(p);
    double longest = -1, second = -1;
    int k;
    for (k = 0; k < p->making_count; ++k) {
        const double taken = p->making[k];
        if (taken > interval) continue;
        if (taken > longest)
            second = longest, longest = taken;
        else if (taken > second)
            second = taken;
    }
    if (second >= 0) return second;
    if (longest >= 0) return longest;
    return p->making_count ? fmin(LEAST(p, making, 0), STALLED / p->fps) : 0;
}

/* ---- refreshes ----------------------------------------------------------------------------------------- */

static double step_of(const gffe_pacer *p) {
    const double interval = usual_interval(p), parts = floor(interval / p->period + SAME);
    return parts > 0 ? interval / parts : p->period;
}

static double refresh_from(const gffe_pacer *p, double now) {
    if (!p->has_last) return now;
    if (p->is_variable) return fmax(now, p->last.refresh + step_of(p));
    return p->last.refresh + fmax(ceil((now - p->last.refresh) / p->period - SAME), 1) * p->period;
}

static double even_refresh_from(const gffe_pacer *p, double now) {
    const double step = step_of(p);
    double first, soonest;
    if (!p->is_variable || !p->has_last || step == p->period) return refresh_from(p, now);
    first = p->times[0] + LEAST(p, delays, 0);
    soonest = fmax(now, p->last.refresh + p->period);
    return fmax(first + ceil((soonest - first) / step - SAME) * step, soonest);
}

/* ---- calls --------------------------------------------------------------------------------------------- */

gffe_status gffe_pacer_start(gffe_pacer *pacer, double display_rate, double most_alpha, double fps, int is_variable) {
    if (!pacer || !is_within(display_rate, 1e-6, 1e6) || !is_within(most_alpha, LEAST_ALPHA, FAR_ALPHA)
        || !is_within(fps, 1e-6, 1e6))
        return GFFE_INVALID;
    memset(pacer, 0, sizeof *pacer);
    pacer->period = 1.0 / display_rate;
    pacer->most_alpha = most_alpha;
    pacer->fps = fps;
    pacer->is_variable = is_variable != 0;
    pacer->now = -MOST_SECONDS;
    pacer->shown = -DBL_MAX;
    return GFFE_OK;
}

gffe_status gffe_pacer_rendered(gffe_pacer *pacer, double time, int reset) {
    if (!pacer || pacer->period <= 0 || !is_within(time, -MOST_SECONDS, MOST_SECONDS)) return GFFE_INVALID;
    if (!reset && pacer->times_count && time <= pacer->times[0]) return GFFE_INVALID;
    if (reset) {
        pacer->times_count = pacer->delays_count = 0;
        pacer->shown = -DBL_MAX;
    }
    pacer->counts.dropped += pacer->is_new;
    APPEND(pacer, times, time);
    pacer->is_new = 1;
    return GFFE_OK;
}

gffe_status gffe_pacer_plan(gffe_pacer *pacer, double now, gffe_paced *planned) {
    double newest, interval, soonest, delay, ahead;
    gffe_paced plan;
    if (!pacer || !planned || !pacer->times_count || !is_within(now, pacer->now, MOST_SECONDS)) return GFFE_INVALID;
    pacer->now = pacer->began = now;
    newest = pacer->times[0];
    interval = usual_interval(pacer);
    soonest = now + usual_making(pacer);
    if (pacer->is_new || !pacer->delays_count) {
        delay = refresh_from(pacer, soonest) - newest;
        if (delay - LEAST(pacer, delays, delay) > interval) pacer->delays_count = 0;
        APPEND(pacer, delays, delay);
    }
    plan.refresh = even_refresh_from(pacer, soonest);
    ahead = fmin(fmax(plan.refresh - LEAST(pacer, delays, 0) - newest, 0), pacer->most_alpha * interval);
    plan.time = ahead >= SAME * pacer->period ? newest + ahead : newest;
    plan.alpha = fmin((plan.time - newest) / interval_of(pacer, 0), pacer->most_alpha);
    plan.held = pacer->has_last && plan.time <= pacer->shown + SAME * pacer->period;
    if (plan.held) {
        plan.refresh = even_refresh_from(pacer, now);
        plan.time = fmax(pacer->shown, newest);
        plan.alpha = pacer->last.alpha;
    }
    if (pacer->has_last && pacer->shown > -DBL_MAX)
        APPEND(pacer, steps, (plan.time - pacer->shown) - (plan.refresh - pacer->last.refresh));
    ++*(plan.held ? &pacer->counts.held : plan.alpha > 0 ? &pacer->counts.extrapolated : &pacer->counts.rendered);
    pacer->is_new = 0;
    pacer->has_last = 1;
    pacer->last = plan;
    pacer->shown = plan.time;
    *planned = plan;
    return GFFE_OK;
}

gffe_status gffe_pacer_ready(gffe_pacer *pacer, double now) {
    if (!pacer || !pacer->has_last || !is_within(now, pacer->now, MOST_SECONDS)) return GFFE_INVALID;
    pacer->now = now;
    pacer->counts.late += now > pacer->last.refresh;
    if (!pacer->last.held) {
        if (pacer->making_count < 2) pacer->delays_count = 0;
        APPEND(pacer, making, now - pacer->began);
    }
    return GFFE_OK;
}

gffe_pacing gffe_pacer_statistics(const gffe_pacer *pacer) {
    gffe_pacing told;
    double mean = 0, squares = 0;
    int k;
    memset(&told, 0, sizeof told);
    if (!pacer) return told;
    told = pacer->counts;
    for (k = 0; k < pacer->steps_count; ++k) mean += pacer->steps[k] / pacer->steps_count;
    for (k = 0; k < pacer->steps_count; ++k) squares += (pacer->steps[k] - mean) * (pacer->steps[k] - mean);
    if (pacer->steps_count > 1) told.jitter = 1e3 * sqrt(squares / pacer->steps_count);
    return told;
}
