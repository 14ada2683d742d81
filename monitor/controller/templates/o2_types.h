/* Types and names of the generated tables, "o2-monitor"; o2_tables.h includes it. */
#ifndef O2_TYPES_H
#define O2_TYPES_H

typedef struct {
    float low;
    float high;
} o2_bounds;

/* a sensor of the bank with a gain in a range */
typedef struct {
    uint8_t column;
    uint8_t kind;
    uint8_t fault;
    uint8_t gains; /* its range in o2_gains */
} o2_claim;

typedef struct {
    uint16_t condition;
    uint8_t signal;
    float low;
    float high;
} o2_range;

typedef struct {
    uint16_t condition;
    uint16_t samples; /* that it stays broken */
} o2_recovery;

typedef struct {
    uint32_t codes;
    uint8_t test;
    bool is_untold; /* the model mistakes its own errors for it */
} o2_fault;

extern const float o2_lag_share[O2_N_LAG];
extern const uint16_t o2_late_steps[O2_N_DELAY];
extern const float o2_late_part[O2_N_DELAY];
extern const o2_claim o2_claims[O2_N_CLAIMS];
extern const o2_bounds o2_gains[O2_N_GAINS];
extern const o2_range o2_ranges[O2_N_RANGES];
extern const o2_bounds o2_plausible[O2_N_SIGNALS];
extern const o2_recovery o2_recoveries[O2_N_RECOVERIES];
extern const o2_fault o2_faults[O2_N_FAULTS];
extern const uint8_t o2_code_tests[O2_N_CODES];
extern const char *const o2_signal_names[];
extern const char *const o2_fault_names[];
extern const char *const o2_code_names[];

void o2_model_step(const float u[], float state[], float *predicted);

#endif
