/* "o2-monitor" for a controller: the upstream wideband sensor, judged sample by sample in C99.
 *
 * Inside: enable conditions, network, windows, response rule with its bank of sensors (windows
 * around fuel cuts included), movement, bias against the vehicle's reference,
 * the electrical tests of the lambda signal, debounce counters, and a status byte for each code.
 * Not inside: fault memory (confirmation, freeze frames, ratios: an event memory has them), driving
 * cycles (begin each by o2_init), learning of the vehicle's reference, the tests
 * behind the catalyst, plug-ins and reports.
 *
 * Everything lies in one o2_monitor: no heap, no globals, no recursion. Compile without options that
 * drop NaN and infinity (-ffast-math). Not reentrant on one o2_monitor.
 */
#ifndef O2_MONITOR_H
#define O2_MONITOR_H

#include <stdbool.h>
#include <stdint.h>

#include "o2_tables.h"

enum { O2_GOOD, O2_STALE, O2_INVALID, O2_OUT_OF_RANGE, O2_OFF_BUS, O2_PINNED, O2_GAP }; /* quality */
enum { O2_PASSED, O2_FAILED, O2_INCONCLUSIVE };                                         /* outcome */
enum { O2_NO_WINDOW, O2_WINDOW, O2_CUT_WINDOW };                                        /* window */

/* Status byte of ISO 14229-1, as far as it shows within one driving cycle. */
#define O2_TEST_FAILED 0x01U
#define O2_FAILED_THIS_CYCLE 0x02U
#define O2_PENDING 0x04U
#define O2_NOT_COMPLETED_SINCE_CLEAR 0x10U
#define O2_FAILED_SINCE_CLEAR 0x20U
#define O2_NOT_COMPLETED_THIS_CYCLE 0x40U

/* All signals on one tick of the grid of O2_PERIOD_NS; fast signals are averaged over the tick. */
typedef struct {
    float value[O2_N_SIGNALS]; /* by the names of o2_tables.h; NAN where a signal is not valid */
    uint8_t quality;           /* of the measured signal; only GOOD and PINNED have a value */
} o2_sample;

/* The reference of the vehicle; o2_any_vehicle holds the model's own. */
typedef struct {
    float offset_low;     /* healthy offsets of the measurement, output's unit */
    float offset_high;
    float gain;           /* of the healthy sensor over the model's */
    bool sensor_expected; /* a sensor that is silent from the start is at fault */
} o2_vehicle;

typedef struct {
    float predicted;     /* output's unit; NAN while an input is not valid */
    uint16_t conditions; /* a bit for each enable condition that holds */
    bool enabled;        /* all of them do */
    bool changed;        /* a status byte, or the fault of a code, is another one */
    bool fault_flag;     /* a code is pending */
    uint8_t window;      /* O2_NO_WINDOW, or the kind of window that ends with this sample */
    uint8_t outcome;     /* of the window */
    uint8_t fault;       /* O2_SOUND unless the window failed */
    float mean;          /* of its residual, output's unit; around fuel cuts oriented like phi */
    float std;
    float evidence;      /* log odds of the likeliest fault, see O2_EVIDENCE_FAIL */
    float offset;        /* fading mean of the residual, output's unit */
} o2_result;

typedef struct {
    o2_vehicle vehicle;
    /* enable conditions */
    uint16_t since[O2_N_RECOVERIES]; /* samples since each was broken */
    float duty[O2_SECOND];           /* of the purge valve */
    bool has_duty;
    /* model and bank of sensors, oriented like phi */
    bool runs; /* the inputs of the sample before were valid */
    float state[O2_N_STATE];
    float lag[3][O2_N_LAG];
    float lag_begin[3][O2_N_LAG]; /* before the window's first sample */
    float phi[O2_N_PAST + O2_N_WINDOW];
    /* the window begun */
    float measured[O2_N_WINDOW];
    uint16_t filled;
    uint8_t kind;
    /* response rule */
    float evidence[O2_N_CLAIMS];
    float sxx[O2_N_COLUMNS];
    float sxy[O2_N_COLUMNS];
    float syy[O2_N_COLUMNS];
    /* movement, in decisions */
    float dead;
    float holds;
    bool may_be_dead;
    /* bias */
    float sum;
    float bounded;
    float weight;
    float square;
    float course[O2_N_COURSE];
    float course_open;
    uint16_t n_windows;
    uint16_t n_course;
    uint16_t course_each;
    uint16_t course_filled;
    /* electrical tests */
    float ready_low;
    float ready_high;
    float still_low;
    float still_high;
    uint16_t waited;
    uint16_t unheard;
    uint16_t not_ready;
    uint16_t heater_full;
    uint16_t heater_regulated;
    float before;      /* reading of the sample before */
    float entry;       /* step to it from another value, signed */
    float visited;     /* value */
    uint16_t visits;   /* to it, more than to all others */
    uint16_t rest;     /* readings in a row like the last one */
    bool burnt;        /* surely, with the sample before */
    uint16_t still;
    uint16_t rested;
    bool heard;
    bool stood;
    bool row_failed[O2_N_TESTS];
    uint16_t row[O2_N_TESTS];
    /* results */
    int8_t counter[O2_N_TESTS]; /* ISO 14229-1: -128 passed, 127 failed */
    uint8_t named[O2_N_TESTS];  /* fault that a matured test has set */
    bool passed[O2_N_TESTS];
    uint8_t status[O2_N_CODES];
    uint8_t fault[O2_N_CODES]; /* that set the code, O2_SOUND before */
} o2_monitor;

extern const o2_vehicle o2_any_vehicle;

/* Begin a driving cycle. */
void o2_init(o2_monitor *m, const o2_vehicle *vehicle);
/* Take the sample of one tick, every tick, valid or not. */
void o2_step(o2_monitor *m, const o2_sample *sample, o2_result *result);

#endif
