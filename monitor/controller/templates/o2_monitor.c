/* "o2-monitor": from a sample to the codes: enable conditions, network, windows, electrical tests, counters. */
#include "o2_monitor.h"

#include <math.h>
#include <string.h>

#include "o2_rules.h"

#define FAILED_COUNT 127
#define PASSED_COUNT (-128)
#define FRESH (O2_NOT_COMPLETED_SINCE_CLEAR | O2_NOT_COMPLETED_THIS_CYCLE)

/* Return a signal oriented like phi = 1/lambda, which rises from lean to rich. */
static float phi_of(float x)
{
#if O2_PHI
    return 1.0f / x;
#else
    return -x;
#endif
}

static uint16_t counted(uint16_t x)
{
    return (x < UINT16_MAX) ? (uint16_t)(x + 1U) : x;
}

/* ---- enable conditions ---- */

static bool in_fuel_cut(const o2_sample *sample)
{
#ifdef O2_FUEL_CUT
    return sample->value[O2_FUEL_CUT] >= O2_NO_CUT;
#else
    (void)sample;
    return false;
#endif
}

/* Return whether the purge valve stays open or shut, moves slowly and is known. */
static bool purge_stays(o2_monitor *m, const o2_sample *sample)
{
#ifdef O2_PURGE_DUTY_PERCENT
    float duty = sample->value[O2_PURGE_DUTY_PERCENT];
    bool stays = false;
    if (!m->has_duty) { /* at the first sample it has not moved */
        m->has_duty = true;
        for (uint16_t i = 0U; i < O2_SECOND; i++) {
            m->duty[i] = duty;
        }
    }
    stays = (fabsf(duty - m->duty[0]) <= O2_PURGE_STEP) &&
            ((duty >= O2_PURGE_OPEN) == (m->duty[O2_SECOND - 1U] >= O2_PURGE_OPEN));
    (void)memmove(&m->duty[0], &m->duty[1], (O2_SECOND - 1U) * sizeof(m->duty[0]));
    m->duty[O2_SECOND - 1U] = duty;
    return stays;
#else
    (void)m;
    (void)sample;
    return true;
#endif
}

static uint16_t without(uint16_t held, uint16_t broken)
{
    return (uint16_t)(held & (broken ^ 0xFFFFU));
}

static uint16_t conditions_of(o2_monitor *m, const o2_sample *sample)
{
    uint16_t held = O2_ENABLED;
    for (uint16_t i = 0U; i < O2_N_INPUTS; i++) {
        if (isnan(sample->value[i]) != 0) {
            held = without(held, O2_OK_INPUTS_VALID | O2_OK_MODEL_SETTLED);
        }
    }
    if (isnan(sample->value[O2_OUTPUT]) != 0) {
        held = without(held, O2_OK_MEASURED_VALID);
    }
    for (uint16_t i = 0U; i < O2_N_RANGES; i++) {
        float x = sample->value[o2_ranges[i].signal];
        if (!((x >= o2_ranges[i].low) && (x <= o2_ranges[i].high))) {
            held = without(held, o2_ranges[i].condition);
        }
    }
    if ((sample->quality == O2_PINNED) && !in_fuel_cut(sample)) {
        held = without(held, O2_OK_TRAINED_RANGE);
    }
    if (!purge_stays(m, sample)) {
        held = without(held, O2_OK_PURGE_STEADY);
    }
    for (uint16_t i = 0U; i < O2_N_RECOVERIES; i++) {
        m->since[i] = ((held & o2_recoveries[i].condition) != 0U) ? counted(m->since[i]) : 0U;
        if (m->since[i] < o2_recoveries[i].samples) {
            held = without(held, o2_recoveries[i].condition);
        }
    }
    return held;
}

static bool holds(uint16_t conditions, uint16_t wanted)
{
    return (conditions & wanted) == wanted;
}

/* ---- results of tests: counters and codes ---- */

static void set_status(o2_monitor *m, uint8_t code, uint8_t status, uint8_t fault, o2_result *result)
{
    if ((m->status[code] != status) || (m->fault[code] != fault)) {
        m->status[code] = status;
        m->fault[code] = fault;
        result->changed = true;
    }
}

static void set_codes(o2_monitor *m, uint8_t fault, o2_result *result)
{
    for (uint16_t c = 0U; c < O2_N_CODES; c++) {
        if ((o2_faults[fault].codes & ((uint32_t)1U << c)) != 0U) {
            uint8_t status = (uint8_t)(m->status[c] & (uint8_t)~FRESH);
            status |= O2_TEST_FAILED | O2_FAILED_THIS_CYCLE | O2_PENDING | O2_FAILED_SINCE_CLEAR;
            set_status(m, (uint8_t)c, status, fault, result);
        }
    }
}

/* Complete the codes that a fault of this test has set, and those never set once every test that
 * can set them has passed. */
static void complete(o2_monitor *m, uint8_t test, o2_result *result)
{
    m->passed[test] = true;
    for (uint16_t c = 0U; c < O2_N_CODES; c++) {
        bool done = o2_faults[m->fault[c]].test == test;
        if (m->fault[c] == O2_SOUND) {
            done = (o2_code_tests[c] & (1U << test)) != 0U;
            for (uint16_t t = 0U; t < O2_N_TESTS; t++) {
                done = done && (m->passed[t] || ((o2_code_tests[c] & (1U << t)) == 0U));
            }
        }
        if (done) {
            uint8_t status = (uint8_t)(m->status[c] & (uint8_t) ~(FRESH | O2_TEST_FAILED));
            set_status(m, (uint8_t)c, status, m->fault[c], result);
        }
    }
}

static void decide(o2_monitor *m, uint8_t test, bool failed, uint8_t fault, o2_result *result)
{
    if (failed) {
        m->named[test] = fault;
        set_codes(m, fault, result);
    } else {
        complete(m, test, result);
    }
}

/* Advance one test's counter by the result of a window or stretch. */
static void count(o2_monitor *m, uint8_t test, bool failed, uint8_t fault, o2_result *result)
{
    int16_t before = m->counter[test];
    int16_t after = 0;
    if (before == (failed ? FAILED_COUNT : PASSED_COUNT)) { /* no result can change it */
        bool renames = failed && (fault != m->named[test]) && (m->named[test] != O2_SOUND);
        if (renames && (o2_faults[fault].codes == o2_faults[m->named[test]].codes)) {
            decide(m, test, true, fault, result);
        }
        return;
    }
    if (failed) {
        after = (int16_t)(((before > 0) ? before : 0) + (int16_t)O2_COUNT_FAIL);
        after = (after > FAILED_COUNT) ? FAILED_COUNT : after;
    } else {
        after = (int16_t)(((before < 0) ? before : 0) - (int16_t)O2_COUNT_PASS);
        after = (after < PASSED_COUNT) ? PASSED_COUNT : after;
    }
    m->counter[test] = (int8_t)after;
    if ((after == FAILED_COUNT) || (after == PASSED_COUNT)) {
        decide(m, test, after == FAILED_COUNT, fault, result);
    }
}

/* Take one of many alike results on samples: enough of them in a row decide at once. */
static void mature(o2_monitor *m, uint8_t test, bool failed, uint8_t fault, o2_result *result)
{
    if (m->row_failed[test] != failed) {
        m->row[test] = 0U;
    }
    m->row_failed[test] = failed;
    m->row[test] = counted(m->row[test]);
    if (m->row[test] == (failed ? O2_TICKS_FAIL : O2_TICKS_PASS)) {
        m->counter[test] = failed ? FAILED_COUNT : PASSED_COUNT;
        decide(m, test, failed, fault, result);
    }
}

/* ---- electrical tests of the measured signal ---- */

static bool engine_runs(const o2_sample *sample)
{
#ifdef O2_ENGINE_SPEED_RPM
    return sample->value[O2_ENGINE_SPEED_RPM] >= O2_RUNNING_RPM;
#else
    (void)sample;
    return true;
#endif
}

/* Return whether the sensor counts as ready where no signal says so: its reading has moved. */
static bool has_moved(o2_monitor *m, const o2_sample *sample, bool running)
{
#ifdef O2_SENSOR_READY
    (void)m;
    (void)sample;
    (void)running;
    return true;
#else
    float x = sample->value[O2_OUTPUT];
    if (!running) {
        m->ready_low = INFINITY;
        m->ready_high = -INFINITY;
        m->waited = 0U;
        return true;
    }
    if ((m->ready_high - m->ready_low) > O2_STUCK_RANGE) {
        return true;
    }
    if (sample->quality == O2_GOOD) {
        m->ready_low = fminf(m->ready_low, x);
        m->ready_high = fmaxf(m->ready_high, x);
    }
#ifndef O2_ENGINE_SPEED_RPM
    m->waited = counted(m->waited);
#endif
    return ((m->ready_high - m->ready_low) > O2_STUCK_RANGE) || (m->waited > O2_FIRST_MOVE);
#endif
}

/* Return whether the heater gives less than it should: full again for long after it was regulated. */
static bool is_cold(o2_monitor *m, const o2_sample *sample, bool running, bool *is_full)
{
#ifdef O2_SENSOR_HEATER_PERCENT
    float duty = sample->value[O2_SENSOR_HEATER_PERCENT];
    bool heats = running && (duty > 0.0f);
    *is_full = heats && (duty >= O2_HEATER_FULL_PERCENT);
    if (*is_full) {
        m->heater_full = counted(m->heater_full);
        return (m->heater_regulated >= O2_HEATER_REGULATED) && (m->heater_full > O2_HEATER_FULL);
    }
    m->heater_full = 0U;
    if (heats) {
        m->heater_regulated = counted(m->heater_regulated);
    }
#else
    (void)m;
    (void)sample;
    (void)running;
    *is_full = false;
#endif
    return false;
}

static void test_ready(o2_monitor *m, const o2_sample *sample, bool ready, bool gone, bool missing,
                       o2_result *result)
{
    bool running = engine_runs(sample);
    bool is_full = false;
    bool cold = is_cold(m, sample, running, &is_full);
    if ((!ready) && (!gone) && running) {
        m->not_ready = counted(m->not_ready);
        if (m->not_ready > O2_NOT_READY_PATIENCE) {
            mature(m, O2_TEST_READY, true, is_full ? O2_FAULT_HEATER : O2_FAULT_NOT_READY, result);
        }
    } else {
        m->not_ready = 0U;
        if (ready && (!missing)) { /* else it is not known yet */
            mature(m, O2_TEST_READY, cold, O2_FAULT_HEATER, result);
        }
    }
}

static void test_communication(o2_monitor *m, const o2_sample *sample, bool ready, bool missing,
                               o2_result *result)
{
    uint8_t q = sample->quality;
    bool asleep = false;
    bool known = true;
#ifdef O2_ENGINE_SPEED_RPM
    if (!isnan(sample->value[O2_ENGINE_SPEED_RPM])) {
        m->stood = !engine_runs(sample);
    }
#endif
    /* with the ignition off an ECU falls silent, which is no fault */
    asleep = missing && m->stood && (q != O2_OFF_BUS);
    m->heard = m->heard || (!missing);
    if (!m->heard) { /* an ECU that was never heard may still be starting */
        known = m->vehicle.sensor_expected && (m->unheard >= O2_START_PATIENCE);
        m->unheard = counted(m->unheard);
    }
    if (known && !asleep) {
        bool invalid = (q == O2_INVALID) && ready;
        uint8_t fault = invalid ? O2_FAULT_SIGNAL_INVALID : O2_FAULT_SIGNAL_MISSING;
        fault = (q == O2_OFF_BUS) ? O2_FAULT_BUS_OFF : fault;
        mature(m, O2_TEST_COMMUNICATION, missing || invalid, fault, result);
    }
}

static void test_signal(o2_monitor *m, const o2_sample *sample, bool moved, o2_result *result)
{
    uint8_t q = sample->quality;
    bool ready = false;
    bool gone = false;
    bool missing = false;
    if (q == O2_GAP) { /* nobody knows how long the signal paused, and whether it came */
        m->not_ready = 0U;
        return;
    }
#ifdef O2_SENSOR_READY
    gone = isnan(sample->value[O2_SENSOR_READY]) != 0;
    ready = gone ? ((q != O2_INVALID) && moved) : (sample->value[O2_SENSOR_READY] > 0.0f);
#else
    ready = (q != O2_INVALID) && moved;
#endif
    missing = (q == O2_STALE) || (q == O2_OFF_BUS) || ((q == O2_INVALID) && gone);
    test_communication(m, sample, ready, missing, result);
    test_ready(m, sample, ready, gone, missing, result);
    if (ready && ((q == O2_GOOD) || (q == O2_PINNED) || (q == O2_OUT_OF_RANGE))) {
        mature(m, O2_TEST_RANGE, q == O2_OUT_OF_RANGE, O2_FAULT_OUT_OF_RANGE, result);
    }
}

/* Take a visit to a value: a jump to it, a rest, and a jump away. */
static void visit(o2_monitor *m, o2_result *result)
{
    if ((m->visits > 0U) && (fabsf(m->before - m->visited) > 0.0f)) {
        m->visits--;
        return;
    }
    m->visited = m->before;
    m->visits = (m->visits > O2_VISITS) ? m->visits : (uint16_t)(m->visits + 1U);
    if ((m->visits == O2_VISITS) && !o2_faults[O2_FAULT_INTERMITTENT].is_untold) {
        m->counter[O2_TEST_RESPONSE] = FAILED_COUNT;
        decide(m, O2_TEST_RESPONSE, true, O2_FAULT_INTERMITTENT, result);
    }
}

/* A signal that jumps to one value again and again; x is NAN while the sensor sleeps. */
static void test_returns(o2_monitor *m, float x, bool burning, o2_result *result)
{
    float step = x - m->before;
    bool jumps = (fabsf(m->entry) >= O2_JUMP) && (fabsf(step) >= O2_JUMP);
    bool may_be_air = (m->entry > 0.0f) && (step < 0.0f) && !m->burnt;
    if (fabsf(step) <= 0.0f) {
        m->rest = counted(m->rest);
    } else {
        if (jumps && (m->rest >= O2_VISIT_LEAST) && !may_be_air) {
            visit(m, result);
        }
        m->entry = step;
        m->before = x;
        m->rest = 1U;
    }
#ifdef O2_FUEL_CUT
    m->burnt = burning;
#else
    (void)burning; /* no signal tells */
#endif
}

static void begin_still(o2_monitor *m)
{
    m->still = 0U;
    m->still_low = INFINITY;
    m->still_high = -INFINITY;
}

static void judge_still(o2_monitor *m, float last, o2_result *result)
{
    bool frozen = (m->still_high - m->still_low) <= O2_STUCK_RANGE;
    uint8_t fault = (last > 1.0f) ? O2_FAULT_STUCK_LEAN : O2_FAULT_STUCK_RICH;
    if (fabsf(last - 1.0f) <= O2_STUCK_BAND) {
        fault = O2_FAULT_STUCK_AT_ONE;
    }
    begin_still(m);
    if (frozen && (last <= (O2_COLD + O2_STUCK_RANGE))) {
        return; /* a healthy sensor that is not heated yet may read so */
    }
    m->rested = (frozen && (last >= O2_SATURATED)) ? counted(m->rested) : 0U;
    if ((m->rested > 0U) && (m->rested <= O2_RESTS)) {
        return; /* or one in a fuel cut that no signal tells */
    }
    if (!(frozen && o2_faults[fault].is_untold)) {
        count(m, O2_TEST_ACTIVITY, frozen, fault, result);
    }
}

/* A frozen signal: no change over so many samples though the engine burns fuel. */
static void test_activity(o2_monitor *m, float x, bool active, o2_result *result)
{
    if ((!active) && (m->still == 0U)) {
        return;
    }
    m->still_low = fminf(m->still_low, x);
    m->still_high = fmaxf(m->still_high, x);
    if (active) {
        m->still++;
        if (m->still == O2_STILL) {
            judge_still(m, x, result);
        }
    } else if (isnan(x) || ((m->still_high - m->still_low) > O2_STUCK_RANGE)) {
        begin_still(m);
        m->rested = 0U;
    } else {
        /* the stretch goes on */
    }
}

/* ---- network and windows ---- */

/* Begin a run of samples with valid inputs, as if the first had held for long. */
static void begin_run(o2_monitor *m, const o2_sample *sample)
{
    float predicted = 0.0f;
    float x = sample->value[O2_OUTPUT];
    (void)memset(m->state, 0, sizeof(m->state));
    for (uint16_t i = 0U; i < O2_N_LAGS; i++) {
        o2_model_step(sample->value, m->state, &predicted);
        if (!isnan(x)) {
#if O2_PHI
            float output = fminf(fmaxf(1.0f / fmaxf(x, 1e-3f), 0.0f), O2_PHI_MOST);
#else
            float output = x;
#endif
            m->state[O2_STATE_OUTPUT] = fminf(fmaxf(output, O2_OUTPUT_LOW), O2_OUTPUT_HIGH);
        }
    }
}

static void predict(o2_monitor *m, const o2_sample *sample, bool is_valid, o2_result *result)
{
    bool begins = !m->runs;
    m->runs = is_valid;
    if (!is_valid) {
        m->kind = O2_NO_WINDOW;
        return;
    }
    if (begins) {
        begin_run(m, sample);
        m->kind = O2_NO_WINDOW;
    }
    o2_model_step(sample->value, m->state, &result->predicted);
    if (begins) {
        o2_bank_begin(m, phi_of(result->predicted));
    }
}

/* Take a sample into the window begun, or begin one; any other kind of sample discards it. */
static bool fill(o2_monitor *m, const o2_sample *sample, uint8_t kind)
{
    uint16_t n = (kind == O2_CUT_WINDOW) ? O2_N_CUT_WINDOW : O2_N_WINDOW;
    if (kind != m->kind) {
        m->kind = kind;
        m->filled = 0U;
    }
    if (kind == O2_NO_WINDOW) {
        return false;
    }
    if (m->filled == 0U) {
        (void)memcpy(m->lag_begin, m->lag, sizeof(m->lag_begin));
    }
    m->measured[m->filled] = sample->value[O2_OUTPUT];
    m->filled++;
    return m->filled == n;
}

/* is_foreign : the model does not describe the reading
 * is_blind : the model can exclude no fault of the test */
static void told(uint8_t *outcome, uint8_t *fault, bool is_foreign, bool is_blind)
{
    bool is_own = (*outcome == O2_FAILED) && o2_faults[*fault].is_untold; /* the model's errors */
    bool is_dead = *fault == O2_FAULT_NO_ACTIVITY;
    if (is_own || (is_foreign && !is_dead) || ((*outcome == O2_PASSED) && is_blind)) {
        *outcome = O2_INCONCLUSIVE;
        *fault = O2_SOUND;
    }
}

static void judge(o2_monitor *m, o2_result *result)
{
    o2_facts facts;
    o2_window(m, &facts);
    told(&facts.outcome, &facts.fault, facts.is_foreign, O2_BLIND_RESPONSE);
    result->window = m->kind;
    result->outcome = facts.outcome;
    result->fault = facts.fault;
    result->mean = facts.mean;
    result->std = facts.std;
    result->evidence = facts.evidence;
    if (facts.outcome != O2_INCONCLUSIVE) {
        count(m, O2_TEST_RESPONSE, facts.outcome == O2_FAILED, facts.fault, result);
    }
    if (m->kind == O2_WINDOW) {
        uint8_t fault = O2_SOUND;
        bool ignore = facts.no_evidence || m->may_be_dead;
        uint8_t outcome = o2_bias(m, facts.offset, ignore, &fault, &result->offset);
        told(&outcome, &fault, facts.is_foreign, O2_BLIND_BIAS);
        if (outcome != O2_INCONCLUSIVE) {
            count(m, O2_TEST_BIAS, outcome == O2_FAILED, fault, result);
        }
        if ((outcome == O2_FAILED) && (facts.outcome != O2_FAILED)) {
            result->outcome = outcome;
            result->fault = fault;
        }
    }
    m->filled = 0U;
}

static uint8_t kind_of(uint16_t conditions)
{
    if (conditions == O2_ENABLED) {
        return O2_WINDOW;
    }
    if (holds(conditions, O2_AROUND_CUT) && !holds(conditions, O2_OK_FUEL_CUT_RECOVERED)) {
        return O2_CUT_WINDOW;
    }
    return O2_NO_WINDOW;
}

/* ---- the object ---- */

void o2_init(o2_monitor *m, const o2_vehicle *vehicle)
{
    (void)memset(m, 0, sizeof(*m));
    m->vehicle = *vehicle;
    for (uint16_t i = 0U; i < O2_N_RECOVERIES; i++) {
        m->since[i] = (o2_recoveries[i].condition == O2_OK_MODEL_SETTLED) ? 0U : o2_recoveries[i].samples;
    }
    for (uint16_t c = 0U; c < O2_N_COLUMNS; c++) {
        m->sxx[c] = O2_GAIN_KNOWN;
        m->sxy[c] = O2_GAIN_KNOWN;
        m->syy[c] = O2_GAIN_KNOWN;
    }
    for (uint16_t c = 0U; c < O2_N_CODES; c++) {
        m->status[c] = FRESH;
    }
    m->ready_low = INFINITY;
    m->ready_high = -INFINITY;
    m->before = NAN;
    m->entry = NAN;
    m->course_each = 1U;
    begin_still(m);
}

/* Copy a sample without values that no such signal has: they are not valid. */
static void plausible(const o2_sample *given, o2_sample *found)
{
    *found = *given;
    for (uint16_t i = 0U; i < O2_N_SIGNALS; i++) {
        float x = found->value[i];
        if (!(isfinite(x) && (x >= o2_plausible[i].low) && (x <= o2_plausible[i].high))) {
            found->value[i] = NAN;
            if ((i == O2_OUTPUT) && ((found->quality == O2_GOOD) || (found->quality == O2_PINNED))) {
                found->quality = isnan(x) ? O2_INVALID : O2_OUT_OF_RANGE;
            }
        }
    }
}

void o2_step(o2_monitor *m, const o2_sample *given, o2_result *result)
{
    o2_sample own;
    const o2_sample *sample = &own;
    uint16_t conditions = 0U;
    bool running = false;
    bool moved = false;
    bool is_valid = false;
    plausible(given, &own);
    conditions = conditions_of(m, sample);
    running = engine_runs(sample);
    moved = has_moved(m, sample, running);
    is_valid = holds(conditions, O2_OK_INPUTS_VALID);
    (void)memset(result, 0, sizeof(*result));
    result->predicted = NAN;
    result->conditions = conditions;
    result->enabled = conditions == O2_ENABLED;
    result->outcome = O2_INCONCLUSIVE;
    test_signal(m, sample, moved, result);
    test_returns(m, (running && moved) ? sample->value[O2_OUTPUT] : NAN,
                 holds(conditions, O2_BURNING), result);
    test_activity(m, sample->value[O2_OUTPUT], running && moved && holds(conditions, O2_BURNING), result);
    predict(m, sample, is_valid, result);
    if (is_valid) {
        bool is_full = fill(m, sample, kind_of(conditions));
        o2_bank_step(m, phi_of(result->predicted));
        if (is_full) {
            judge(m, result);
        }
    }
    for (uint16_t c = 0U; c < O2_N_CODES; c++) {
        result->fault_flag = result->fault_flag || ((m->status[c] & O2_PENDING) != 0U);
    }
}
