/* Judges drives from standard input; prints verdicts, changes of codes, and sums.
 *
 *     driver OFFSET_LOW OFFSET_HIGH GAIN EXPECTED [FILE]
 *
 * A drive is its number of samples as uint32, then for each sample O2_N_SIGNALS floats and the
 * quality as another; no samples end it all. Where ticks can be counted, it tells those of a drive.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "o2_monitor.h"

static o2_monitor monitor;

#ifdef O2_TICKS
extern uint32_t ticks(void);
extern uint32_t ticks_since(uint32_t before);
#endif

static void say(const o2_result *r, unsigned k, uint8_t status[], uint8_t fault[])
{
    if (r->window != O2_NO_WINDOW) {
        printf("w %u %u %u %s %.6f\n", k, (unsigned)r->window, (unsigned)r->outcome,
               o2_fault_names[r->fault], (double)r->evidence);
    }
    for (unsigned c = 0U; c < O2_N_CODES; c++) {
        if ((monitor.status[c] != status[c]) || (monitor.fault[c] != fault[c])) {
            status[c] = monitor.status[c];
            fault[c] = monitor.fault[c];
            printf("c %u %s %s %u\n", k, o2_code_names[c], o2_fault_names[fault[c]],
                   (unsigned)status[c]);
        }
    }
}

static int judge(FILE *in, uint32_t n, const o2_vehicle *vehicle)
{
    float row[O2_N_SIGNALS + 1U];
    uint8_t status[O2_N_CODES];
    uint8_t fault[O2_N_CODES];
    o2_sample sample;
    o2_result result = {.fault_flag = false};
    double sum = 0.0;
    unsigned enabled = 0U;
#ifdef O2_TICKS
    double all = 0.0;
    uint32_t most = 0U;
#endif
    o2_init(&monitor, vehicle);
    for (unsigned c = 0U; c < O2_N_CODES; c++) {
        status[c] = monitor.status[c];
        fault[c] = monitor.fault[c];
    }
    for (unsigned k = 0U; k < n; k++) {
        if (fread(row, sizeof(row), 1U, in) != 1U) {
            return 2;
        }
        for (unsigned i = 0U; i < O2_N_SIGNALS; i++) {
            sample.value[i] = row[i];
        }
        sample.quality = (uint8_t)row[O2_N_SIGNALS];
#ifdef O2_TICKS
        uint32_t before = ticks();
        o2_step(&monitor, &sample, &result);
        before = ticks_since(before);
        all += before;
        most = (before > most) ? before : most;
#else
        o2_step(&monitor, &sample, &result);
#endif
        say(&result, k, status, fault);
        enabled += result.enabled ? 1U : 0U;
        sum += isnan(result.predicted) ? 0.0 : (double)result.predicted;
    }
    printf("e %u %.5f %d\n", enabled, sum, result.fault_flag ? 1 : 0);
#ifdef O2_TICKS
    fprintf(stderr, "ticks %.0f most %lu\n", all, (unsigned long)most);
#endif
    return 0;
}

int main(int argc, char *argv[])
{
    uint32_t n = 0U;
    int code = 0;
    FILE *in = (argc == 6) ? fopen(argv[5], "rb") : stdin;
    o2_vehicle vehicle = o2_any_vehicle;
    if ((argc < 5) || (in == NULL)) {
        return 2;
    }
    vehicle.offset_low = strtof(argv[1], NULL);
    vehicle.offset_high = strtof(argv[2], NULL);
    vehicle.gain = strtof(argv[3], NULL);
    vehicle.sensor_expected = argv[4][0] == '1';
    while ((code == 0) && (fread(&n, sizeof(n), 1U, in) == 1U) && (n > 0U)) {
        code = judge(in, n, &vehicle);
    }
    return code;
}
