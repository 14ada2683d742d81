/* "o2-monitor": bank of sensors, response rule, movement and bias: what a full window says. */
#include "o2_rules.h"

#include <math.h>
#include <string.h>

#define N_HISTORY (O2_N_PAST + O2_N_WINDOW)
#define LATE (1U + (3U * O2_N_LAG)) /* first column with a dead time */

static float square_of(float x)
{
    return x * x;
}

static float limited(float x, float low, float high)
{
    return fminf(fmaxf(x, low), high);
}

/* ---- bank: readings of slow and late sensors of the predicted signal ---- */

static float slowed(float x, float now, float share, uint8_t direction)
{
    float whole = now - x;
    float part = share * whole;
    if (direction == 0U) { /* slow from rich to lean, where phi falls */
        part = fmaxf(part, whole);
    } else if (direction == 1U) {
        part = fminf(part, whole);
    } else {
        /* slow both ways */
    }
    return x + part;
}

static void slow_step(float lag[3][O2_N_LAG], float now)
{
    for (uint8_t d = 0U; d < 3U; d++) {
        for (uint16_t i = 0U; i < O2_N_LAG; i++) {
            lag[d][i] = slowed(lag[d][i], now, o2_lag_share[i], d);
        }
    }
}

static float late_reading(const float *now, uint16_t which, uint8_t direction)
{
    uint16_t steps = o2_late_steps[which];
    float part = o2_late_part[which];
    float late = ((1.0f - part) * now[-(int32_t)steps]) + (part * now[-(int32_t)steps - 1]);
    if (direction == 0U) {
        late = fmaxf(late, now[0]);
    } else if (direction == 1U) {
        late = fminf(late, now[0]);
    } else {
        /* late both ways */
    }
    return late;
}

void o2_bank_begin(o2_monitor *m, float phi)
{
    for (uint16_t i = 0U; i < N_HISTORY; i++) {
        m->phi[i] = phi;
    }
    for (uint8_t d = 0U; d < 3U; d++) {
        for (uint16_t i = 0U; i < O2_N_LAG; i++) {
            m->lag[d][i] = phi;
        }
    }
}

void o2_bank_step(o2_monitor *m, float phi)
{
    (void)memmove(&m->phi[0], &m->phi[1], (N_HISTORY - 1U) * sizeof(m->phi[0]));
    m->phi[N_HISTORY - 1U] = phi;
    slow_step(m->lag, phi);
}

/* Return the samples of the window just filled. */
static const float *window_of(const o2_monitor *m, uint16_t n)
{
    return &m->phi[N_HISTORY - n];
}

/* Fill in what every sensor of the bank reads at a sample; lag : behind it. */
static void readings(const float *now, float lag[3][O2_N_LAG], float x[O2_N_COLUMNS])
{
    uint16_t column = 1U;
    x[0] = now[0];
    for (uint8_t d = 0U; d < 3U; d++) {
        for (uint16_t i = 0U; i < O2_N_LAG; i++) {
            x[column] = lag[d][i];
            column++;
        }
    }
    for (uint8_t d = 0U; d < 3U; d++) {
        for (uint16_t i = 0U; i < O2_N_DELAY; i++) {
            x[column] = late_reading(now, i, d);
            column++;
        }
    }
    x[column] = ((1.0f - O2_AHEAD_PART) * now[O2_AHEAD]) + (O2_AHEAD_PART * now[O2_AHEAD - O2_AHEAD_BACK]);
}

static float unoriented(float phi)
{
#if O2_PHI
    return 1.0f / phi;
#else
    return -phi;
#endif
}

static float median_of(float x[], uint16_t n)
{
    for (uint16_t k = 1U; k < n; k++) {
        float own = x[k];
        uint16_t to = k;
        while ((to > 0U) && (x[to - 1U] > own)) {
            x[to] = x[to - 1U];
            to--;
        }
        x[to] = own;
    }
    return 0.5f * (x[(n - 1U) / 2U] + x[n / 2U]);
}

/* Return the window's median of the measurement against one sensor of the bank. */
static float beside(const o2_monitor *m, uint16_t n, uint16_t column)
{
    const float *now = window_of(m, n);
    float apart[O2_N_WINDOW];
    float lag = 0.0f;
    uint16_t slow = (column > 0U) ? (uint16_t)(column - 1U) : 0U;
    uint16_t late = (column >= LATE) ? (uint16_t)(column - LATE) : 0U;
    bool is_slow = (column > 0U) && (column < LATE);
    if (is_slow) {
        lag = m->lag_begin[slow / O2_N_LAG][slow % O2_N_LAG];
    }
    for (uint16_t k = 0U; k < n; k++) {
        float reading = now[k];
        if (is_slow) {
            lag = slowed(lag, now[k], o2_lag_share[slow % O2_N_LAG], (uint8_t)(slow / O2_N_LAG));
            reading = lag;
        } else if (column >= LATE) {
            reading = late_reading(&now[k], late % O2_N_DELAY, (uint8_t)(late / O2_N_DELAY));
        } else {
            /* the prediction itself */
        }
        apart[k] = m->measured[k] - unoriented(reading);
    }
    return median_of(apart, n);
}

/* ---- response rule: evidence for each claim about the sensor ---- */

/* Moments of every sensor's whitened reading x, at the gain expected, with the measurement y and of
 * the rest y - x. The error of a sensor of any gain follows from those that are near: it is no small
 * difference of large sums, so float is enough. */
typedef struct {
    float yy;
    float xx[O2_N_COLUMNS];
    float xy[O2_N_COLUMNS];
    float rr[O2_N_COLUMNS];
} o2_moments;

/* Walk through the window's whitened readings: once for their means, once for the moments. */
static void walk(const o2_monitor *m, uint16_t n, float gain, const float y[],
                 float mean[O2_N_COLUMNS], o2_moments *s)
{
    float before[O2_N_COLUMNS];
    float x[O2_N_COLUMNS];
    float lag[3][O2_N_LAG];
    uint16_t n_new = (uint16_t)(n - O2_AHEAD - 1U);
    float each = 1.0f / (float)n_new;
    const float *now = window_of(m, n);
    (void)memcpy(lag, m->lag_begin, sizeof(lag));
    slow_step(lag, now[0]);
    readings(now, lag, before);
    for (uint16_t k = 0U; k < n_new; k++) {
        slow_step(lag, now[k + 1U]);
        readings(&now[k + 1U], lag, x);
        for (uint16_t c = 0U; c < O2_N_COLUMNS; c++) {
            float part = gain * (x[c] - (O2_NOISE_MEMORY * before[c]));
            before[c] = x[c];
            if (s == NULL) {
                mean[c] += part * each;
            } else {
                part -= mean[c];
                s->xx[c] += part * part * each;
                s->xy[c] += part * y[k] * each;
                s->rr[c] += square_of(y[k] - part) * each;
            }
        }
    }
}

static void regressed(const o2_monitor *m, uint16_t n, float gain, const float y[],
                      o2_moments *s)
{
    float mean[O2_N_COLUMNS];
    uint16_t n_new = (uint16_t)(n - O2_AHEAD - 1U);
    (void)memset(mean, 0, sizeof(mean));
    (void)memset(s, 0, sizeof(*s));
    for (uint16_t k = 0U; k < n_new; k++) {
        s->yy += square_of(y[k]) / (float)n_new;
    }
    walk(m, n, gain, y, mean, NULL);
    walk(m, n, gain, y, mean, s);
}

/* The gain of the timing, from all windows. */
static float gain_of(const o2_monitor *m, uint16_t column)
{
    return fmaxf(m->sxy[column] / m->sxx[column], O2_GAIN_FOLLOWS);
}

static float error_var(const o2_moments *s, uint16_t column, float gain, float least)
{
    bool is_weak = gain < 0.5f;
    float beyond = is_weak ? gain : (gain - 1.0f);
    float xy = is_weak ? s->xy[column] : (s->xy[column] - s->xx[column]);
    float found = (is_weak ? s->yy : s->rr[column]) - (beyond * ((2.0f * xy) - (beyond * s->xx[column])));
    return fmaxf(found, 0.0f) + least;
}

static float best_evidence(const o2_monitor *m, uint8_t kind)
{
    float best = -INFINITY;
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        if (o2_claims[c].kind == kind) {
            best = fmaxf(best, m->evidence[c]);
        }
    }
    return best;
}

/* No claim falls further behind the best one than O2_EVIDENCE_MOST. */
static void bound_evidence(o2_monitor *m)
{
    float best = -INFINITY;
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        best = fmaxf(best, m->evidence[c]);
    }
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        m->evidence[c] = fmaxf(m->evidence[c] - best, -O2_EVIDENCE_MOST);
    }
}

/* Add a window to the columns' gains. */
static void add_gains(o2_monitor *m, const o2_moments *s, float n_new)
{
    for (uint16_t c = 0U; c < O2_N_COLUMNS; c++) {
        float part = n_new / error_var(s, c, gain_of(m, c), O2_LEAST_VAR);
        m->sxx[c] = (O2_GAIN_MEMORY * m->sxx[c]) + (part * s->xx[c]);
        m->sxy[c] = (O2_GAIN_MEMORY * m->sxy[c]) + (part * s->xy[c]);
        m->syy[c] = (O2_GAIN_MEMORY * m->syy[c]) + (part * s->yy);
    }
}

/* Return the log likelihood of a claim's timing; errors of the prediction only lower a gain. */
static float timing(const o2_monitor *m, const o2_moments *s, const o2_claim *claim, float n_new)
{
    float gain = fminf(gain_of(m, claim->column), o2_gains[claim->gains].high);
    return -0.5f * n_new * logf(error_var(s, claim->column, gain, O2_LEAST_VAR));
}

/* Return how far a window's amplitude is from those of a claim, as logarithms of squares. */
static float amplitude_off(const o2_moments *s, const o2_claim *claim)
{
    const o2_bounds *range = &o2_gains[claim->gains];
    float measured = logf(s->yy + O2_LEAST_VAR);
    float least = logf((square_of(range->low) * s->xx[claim->column]) + O2_INNOVATION_VAR);
    float most = logf((square_of(range->high) * s->xx[claim->column]) + O2_INNOVATION_VAR);
    return fmaxf(least - measured, 0.0f) + fmaxf(measured - most, 0.0f);
}

/* Add a window to gains and evidence; phi : the measurement, oriented like phi. */
static void add_window(o2_monitor *m, uint16_t n, float gain, const float phi[])
{
    float y[O2_N_WINDOW];
    float said[O2_N_CLAIMS];
    o2_moments s;
    uint16_t n_new = (uint16_t)(n - O2_AHEAD - 1U);
    float mean = 0.0f;
    float best = -INFINITY;
    for (uint16_t k = 0U; k < n_new; k++) {
        y[k] = phi[k + 1U] - (O2_NOISE_MEMORY * phi[k]);
        mean += y[k];
    }
    mean /= (float)n_new;
    for (uint16_t k = 0U; k < n_new; k++) {
        y[k] -= mean;
    }
    regressed(m, n, gain, y, &s);
    add_gains(m, &s, (float)n_new);
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        said[c] = (O2_WEIGHT * timing(m, &s, &o2_claims[c], (float)n_new)) -
                  (O2_WEIGHT_GAIN * amplitude_off(&s, &o2_claims[c]));
        best = fmaxf(best, said[c]);
    }
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        m->evidence[c] += fmaxf(said[c] - best, -O2_EVIDENCE_WINDOW);
    }
    bound_evidence(m);
}

/* Return whether no column explains as much of the reading as the model did in training. */
static bool is_foreign(const o2_monitor *m)
{
    float most = 0.0f;
    for (uint16_t c = 0U; c < O2_N_COLUMNS; c++) {
        most = fmaxf(most, square_of(m->sxy[c]) / (m->sxx[c] * m->syy[c]));
    }
    return most < O2_LEAST_EXPLAINED;
}

/* Fill in outcome, fault and evidence; return the column of the likeliest sensor. */
static uint16_t report(const o2_monitor *m, bool counts, o2_facts *facts)
{
    float best = -INFINITY;
    float fault = -INFINITY;
    uint16_t likeliest = 0U;
    float surely = best_evidence(m, O2_SURELY);
    float barely = best_evidence(m, O2_BARELY);
    float tested = best_evidence(m, O2_FAULTY);
    facts->fault = O2_SOUND;
    facts->outcome = O2_INCONCLUSIVE;
    for (uint16_t c = 0U; c < O2_N_CLAIMS; c++) {
        if (m->evidence[c] > best) {
            best = m->evidence[c];
            likeliest = c;
        }
        bool faulty = (o2_claims[c].kind == O2_FAULTY) || (o2_claims[c].kind == O2_UNTESTED);
        if (faulty && (m->evidence[c] > fault)) {
            fault = m->evidence[c];
            facts->fault = o2_claims[c].fault;
        }
    }
    facts->evidence = fault - fmaxf(surely, barely);
    if (counts && (facts->evidence >= O2_EVIDENCE_FAIL)) {
        facts->outcome = O2_FAILED;
    } else {
        facts->fault = O2_SOUND;
        if (counts && ((surely - fmaxf(tested, barely)) >= O2_EVIDENCE_PASS)) {
            facts->outcome = O2_PASSED;
        }
    }
    facts->is_foreign = is_foreign(m);
    return (o2_claims[likeliest].column < (O2_N_COLUMNS - 1U)) ? o2_claims[likeliest].column : 0U;
}

/* ---- movement: a dead sensor, or one that holds now and then ---- */

static float variance(const float x[], uint16_t n)
{
    float mean = 0.0f;
    float sum = 0.0f;
    for (uint16_t k = 0U; k < n; k++) {
        mean += x[k];
    }
    mean /= (float)n;
    for (uint16_t k = 0U; k < n; k++) {
        sum += square_of(x[k] - mean);
    }
    return sum / (float)n;
}

static float dead_ratio(float own, float predicted, uint16_t n, bool around_cut)
{
    float moves = fmaxf(predicted - (O2_ERROR_SHARE * O2_NOISE_VAR), 0.0f);
    float least_alive = square_of(O2_MOVEMENT_GAIN) * moves;
    float most = O2_STILL_SHARE * fmaxf(O2_NOISE_VAR, around_cut ? 0.0f : least_alive);
    float still = limited(own, O2_QUANTUM_VAR, fmaxf(most, O2_QUANTUM_VAR));
    float alive = still + least_alive;
    float ratio = logf(alive / still) - (own * ((1.0f / still) - (1.0f / alive)));
    return limited(0.5f * (float)n * O2_INDEPENDENT * ratio, -0.5f * O2_EVIDENCE_FAIL,
                   0.5f * O2_EVIDENCE_FAIL);
}

/* Return the evidence of the longest hold of a window. */
static float hold_ratio(const float phi[], const float *now, float predicted, uint16_t n)
{
    uint16_t longest = 0U;
    uint16_t length = 0U;
    uint16_t end = 1U;
    float step = INFINITY;
    float high = -INFINITY;
    float low = INFINITY;
    for (uint16_t k = 1U; k < n; k++) {
        float moved = fabsf(phi[k] - phi[k - 1U]);
        length = (moved > 0.0f) ? 0U : (uint16_t)(length + 1U);
        step = (moved > 0.0f) ? fminf(step, moved) : step;
        if (length > longest) {
            longest = length;
            end = k;
        }
    }
    if ((longest < O2_HOLD) || (longest >= (n - 1U))) {
        return (predicted > (O2_ERROR_SHARE * O2_NOISE_VAR)) ? -O2_NO_HOLD : 0.0f;
    }
    for (uint16_t k = (uint16_t)(end - longest); k <= end; k++) {
        high = fmaxf(high, now[k]);
        low = fminf(low, now[k]);
    }
    step = fmaxf((O2_MOVEMENT_GAIN * (high - low)) - step, 0.0f);
    return fminf(square_of(step) / (4.0f * O2_NOISE_VAR), 0.5f * O2_EVIDENCE_FAIL);
}

static void judge_movement(o2_monitor *m, uint16_t n, const float phi[], bool skip,
                           o2_facts *facts)
{
    const float *now = window_of(m, n);
    bool around_cut = m->kind == O2_CUT_WINDOW;
    if (!skip) {
        float predicted = variance(now, n);
        float dead = dead_ratio(variance(phi, n), predicted, n, around_cut);
        float held = around_cut ? 0.0f : hold_ratio(phi, now, predicted, n);
        m->dead = limited(m->dead + (dead / O2_EVIDENCE_FAIL), -1.0f, O2_MOVEMENT_BOUND);
        m->holds = limited(m->holds + (held / O2_EVIDENCE_FAIL), 0.0f, O2_MOVEMENT_BOUND);
    }
    m->may_be_dead = fmaxf(m->dead, m->holds) >= O2_MOVEMENT_DOUBT;
    if (fmaxf(m->dead, m->holds) >= 1.0f) {
        facts->outcome = O2_FAILED;
        facts->fault = (m->dead >= 1.0f) ? O2_FAULT_NO_ACTIVITY : O2_FAULT_INTERMITTENT;
    } else if (m->may_be_dead) {
        facts->outcome = O2_INCONCLUSIVE;
        facts->fault = O2_SOUND;
    } else {
        /* the reading moves */
    }
}

/* ---- a window ---- */

static float oriented(float measured)
{
#if O2_PHI
    return 1.0f / fmaxf(measured, O2_LEAST_MEASURED);
#else
    return -measured;
#endif
}

void o2_window(o2_monitor *m, o2_facts *facts)
{
    bool around_cut = m->kind == O2_CUT_WINDOW;
    uint16_t n = around_cut ? O2_N_CUT_WINDOW : O2_N_WINDOW;
    const float *now = window_of(m, n);
    float phi[O2_N_WINDOW]; /* at first the residual */
    float high = -INFINITY;
    float low = INFINITY;
    bool skip = false;
    uint16_t column = 0U;
    facts->mean = 0.0f;
    for (uint16_t k = 0U; k < n; k++) {
        float measured = m->measured[k];
        phi[k] = around_cut ? (oriented(measured) - now[k]) : (measured - unoriented(now[k]));
        facts->mean += phi[k];
        high = fmaxf(high, measured);
        low = fminf(low, measured);
    }
    facts->mean /= (float)n;
    facts->std = sqrtf(variance(phi, n));
    /* an offset in lambda would change the gain in phi */
    for (uint16_t k = 0U; k < n; k++) {
        phi[k] = oriented(m->measured[k] - (around_cut ? 0.0f : facts->mean));
    }
    skip = (high - low) <= O2_STUCK_RANGE;
    facts->no_evidence = (!around_cut) && skip;
    if (!skip) {
        add_window(m, n, O2_GAIN_MODEL * m->vehicle.gain, phi);
    }
    column = report(m, !skip, facts);
    facts->offset = around_cut ? 0.0f : beside(m, n, column);
    /* around a cut a reading at the end of its range is in air */
    skip = skip || (around_cut && (low >= (O2_RANGE_END - O2_STUCK_RANGE)));
    judge_movement(m, n, phi, skip, facts);
}

/* ---- bias: a fading mean of the residual against the healthy offsets ---- */

static float bounded(float mean, float low, float high)
{
    float most = O2_BIAS_CERTAINTY * O2_OFFSET_STD;
    return limited(mean, low - most, high + most);
}

static void add_course(o2_monitor *m, float offset)
{
    m->course_open += offset;
    m->course_filled++;
    if (m->course_filled < m->course_each) {
        return;
    }
    m->course[m->n_course] = m->course_open / (float)m->course_each;
    m->n_course++;
    m->course_open = 0.0f;
    m->course_filled = 0U;
    if (m->n_course == O2_N_COURSE) { /* thinned out */
        m->n_course = O2_N_COURSE / 2U;
        for (uint16_t i = 0U; i < m->n_course; i++) {
            m->course[i] = 0.5f * (m->course[2U * i] + m->course[(2U * i) + 1U]);
        }
        m->course_each = (uint16_t)(m->course_each * 2U);
    }
}

/* Return whether a straight line describes the course, and neither a step nor a constant. */
static bool drifts(const o2_monitor *m)
{
    float n = (float)m->n_course;
    float mean = 0.0f;
    float slope = 0.0f;
    float moment = 0.0f;
    float total = 0.0f;
    float line = 0.0f;
    float sum = 0.0f;
    float most = 0.0f;
    if (m->n_course < O2_COURSE_LEAST) {
        return false;
    }
    for (uint16_t i = 0U; i < m->n_course; i++) {
        mean += m->course[i] / n;
    }
    for (uint16_t i = 0U; i < m->n_course; i++) {
        float t = (float)i - (0.5f * (n - 1.0f));
        slope += t * (m->course[i] - mean);
        moment += t * t;
        total += square_of(m->course[i] - mean);
    }
    slope /= moment;
    for (uint16_t i = 0U; i < m->n_course; i++) {
        float t = (float)i - (0.5f * (n - 1.0f));
        float y = m->course[i] - mean;
        line += square_of(y - (slope * t));
        sum += y;
        if ((i + 1U) < m->n_course) { /* what is left of the sum is -sum */
            float k = (float)i + 1.0f;
            most = fmaxf(most, (square_of(sum) / k) + (square_of(sum) / (n - k)));
        }
    }
    return ((fabsf(slope) * n) > (O2_COURSE_RISE * O2_OFFSET_STD)) && (line < (total - most));
}

static float middle_of(const float course[], uint16_t n)
{
    float sorted[O2_N_COURSE] = {0};
    for (uint16_t i = 0U; i < n; i++) {
        uint16_t at = i;
        while ((at > 0U) && (sorted[at - 1U] > course[i])) {
            sorted[at] = sorted[at - 1U];
            at--;
        }
        sorted[at] = course[i];
    }
    return 0.5f * (sorted[n / 2U] + sorted[(n - 1U) / 2U]);
}

/* Return the step of an offset that began within the drive, 0 without one. */
static float stepped(const o2_monitor *m)
{
    uint16_t n = m->n_course;
    float high = -INFINITY;
    float low = INFINITY;
    float total = 0.0f;
    float sum = 0.0f;
    float surest = -INFINITY;
    float found = 0.0f;
    float healthy = 0.5f * (m->vehicle.offset_low + m->vehicle.offset_high);
    float middle = 0.0f;
    for (uint16_t i = 0U; i < n; i++) {
        high = fmaxf(high, m->course[i]);
        low = fminf(low, m->course[i]);
    }
    if ((n < O2_COURSE_LEAST) || !((high - low) > O2_STEP_MOST)) {
        return 0.0f;
    }
    middle = middle_of(m->course, n);
    for (uint16_t i = 0U; i < n; i++) {
        total += bounded(m->course[i], middle - O2_STEP_MOST, middle + O2_STEP_MOST);
    }
    for (uint16_t k = 1U; k <= (uint16_t)(n - O2_COURSE_EDGE); k++) {
        float left = (float)n - (float)k;
        float own = (1.0f - O2_SHARED) / (float)m->course_each *
                    ((1.0f / (float)k) + (1.0f / left));
        float before = 0.0f;
        float after = 0.0f;
        float sure = 0.0f;
        sum += bounded(m->course[k - 1U], middle - O2_STEP_MOST, middle + O2_STEP_MOST);
        before = sum / (float)k;
        after = (total - sum) / left;
        sure = (fabsf(after - before) - O2_STEP_MOST) /
               (O2_OFFSET_STD * sqrtf((2.0f * O2_SHARED) + own));
        if ((k >= O2_COURSE_EDGE) && (sure > surest) &&
            (fabsf(after - healthy) > fabsf(before - healthy))) {
            surest = sure;
            found = after - before;
        }
    }
    return (surest > O2_BIAS_CERTAINTY) ? found : 0.0f;
}

static uint8_t named_bias(const o2_monitor *m, bool is_lean)
{
    if (drifts(m)) {
        return is_lean ? O2_FAULT_DRIFT_LEAN : O2_FAULT_DRIFT_RICH;
    }
    return is_lean ? O2_FAULT_BIASED_LEAN : O2_FAULT_BIASED_RICH;
}

uint8_t o2_bias(o2_monitor *m, float mean, bool ignore, uint8_t *fault, float *offset)
{
    float low = m->vehicle.offset_low;
    float high = m->vehicle.offset_high;
    float judged = 0.0f;
    float beyond = 0.0f;
    float step = 0.0f;
    *fault = O2_SOUND;
    if (!ignore) {
        m->n_windows = (m->n_windows < O2_BIAS_WINDOWS) ? (uint16_t)(m->n_windows + 1U) : m->n_windows;
        add_course(m, mean);
        m->sum = (O2_BIAS_MEMORY * m->sum) + mean;
        m->bounded = (O2_BIAS_MEMORY * m->bounded) + bounded(mean, low, high);
        m->weight = (O2_BIAS_MEMORY * m->weight) + 1.0f;
        m->square = (O2_BIAS_MEMORY * O2_BIAS_MEMORY * m->square) + 1.0f;
    }
    *offset = (m->weight > 0.0f) ? (m->sum / m->weight) : 0.0f;
    if (ignore) {
        return O2_INCONCLUSIVE;
    }
    judged = m->bounded / m->weight;
    beyond = fmaxf(judged - high, low - judged) /
             (O2_OFFSET_STD * sqrtf(O2_SHARED + ((1.0f - O2_SHARED) * m->square / square_of(m->weight))));
    step = stepped(m);
    if (step != 0.0f) {
        *fault = named_bias(m, step > 0.0f);
        return O2_FAILED;
    }
    if ((m->n_windows < O2_BIAS_WINDOWS) || ((beyond >= 0.0f) && (beyond <= O2_BIAS_CERTAINTY))) {
        return O2_INCONCLUSIVE;
    }
    if (beyond < 0.0f) {
        return O2_PASSED;
    }
    *fault = named_bias(m, judged > high);
    return O2_FAILED;
}
