/* "o2-monitor": the rules on a full window; o2_monitor.c alone calls them. */
#ifndef O2_RULES_H
#define O2_RULES_H

#include "o2_monitor.h"

typedef struct {
    float mean;
    float std;
    float offset; /* median of the measurement against the likeliest sensor, output's unit */
    float evidence;
    uint8_t outcome;
    uint8_t fault;
    bool no_evidence; /* the window counts for nothing */
    bool is_foreign;  /* the model does not describe the reading */
} o2_facts;

void o2_bank_begin(o2_monitor *m, float phi);
void o2_bank_step(o2_monitor *m, float phi);
void o2_window(o2_monitor *m, o2_facts *facts);
/* Return the outcome after one more window; an ignored one is inconclusive. */
uint8_t o2_bias(o2_monitor *m, float mean, bool ignore, uint8_t *fault, float *offset);

#endif
