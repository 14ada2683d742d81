/* "o2-monitor": judges a table on the host: columns by the names of o2_signal_names, one row for each tick; an
 * empty cell, or one that is no number, is not valid. A column "quality" is that of the measured signal. Without it the signal
 * is good wherever it has a value, and stale elsewhere. Prints windows and codes.
 *
 *     example drive.csv
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "o2_monitor.h"

#define MOST_COLUMNS 64
#define QUALITY (-2)

static int place_of(const char *name)
{
    for (int i = 0; i < (int)O2_N_SIGNALS; i++) {
        if (strcmp(name, o2_signal_names[i]) == 0) {
            return i;
        }
    }
    return (strcmp(name, "quality") == 0) ? QUALITY : -1;
}

/* Cut a line at its commas; return how many cells it has. */
static int cells(char *line, char *cell[MOST_COLUMNS])
{
    int n = 0;
    line[strcspn(line, "\r\n")] = '\0';
    while (n < MOST_COLUMNS) {
        cell[n] = line;
        n++;
        line = strchr(line, ',');
        if (line == NULL) {
            break;
        }
        *line = '\0';
        line++;
    }
    return n;
}

static void fill(o2_sample *sample, char *cell[MOST_COLUMNS], int n, const int place[MOST_COLUMNS])
{
    bool is_told = false;
    for (int i = 0; i < (int)O2_N_SIGNALS; i++) {
        sample->value[i] = NAN;
    }
    for (int i = 0; i < n; i++) {
        if (place[i] == QUALITY) {
            sample->quality = (uint8_t)strtoul(cell[i], NULL, 10);
            is_told = true;
        } else if (place[i] >= 0) {
            char *end = NULL;
            float value = strtof(cell[i], &end);
            sample->value[place[i]] = (end == cell[i]) ? NAN : value;
        }
    }
    if (!is_told) {
        sample->quality = (uint8_t)(isnan(sample->value[O2_OUTPUT]) ? O2_STALE : O2_GOOD);
    }
}

/* Name the signals that the table lacks; return whether it has the measured one. */
static bool has_output(int n, const int place[MOST_COLUMNS])
{
    bool has[O2_N_SIGNALS] = {false};
    for (int i = 0; i < n; i++) {
        if (place[i] >= 0) {
            has[place[i]] = true;
        }
    }
    for (int i = 0; i < (int)O2_N_SIGNALS; i++) {
        if (!has[i]) {
            fprintf(stderr, "example: no column %s%s\n", o2_signal_names[i],
                    (i == (int)O2_OUTPUT) ? ", nothing to judge" : "");
        }
    }
    return has[O2_OUTPUT];
}

static void print(const o2_monitor *m, const o2_result *r, long tick)
{
    static const char *const outcomes[] = {"passed", "failed", "inconclusive"};
    double t_s = (double)tick * O2_PERIOD_NS * 1e-9;
    if (r->window != O2_NO_WINDOW) {
        printf("%.2f s %s %s %s evidence %.4f mean %.5f\n", t_s,
               (r->window == O2_WINDOW) ? "window" : "cut", outcomes[r->outcome],
               o2_fault_names[r->fault], (double)r->evidence, (double)r->mean);
    }
    if (r->changed) {
        for (unsigned c = 0U; c < O2_N_CODES; c++) {
            if (m->fault[c] != O2_SOUND) {
                printf("%.2f s code %s %s status 0x%02X\n", t_s, o2_code_names[c],
                       o2_fault_names[m->fault[c]], (unsigned)m->status[c]);
            }
        }
    }
}

int main(int argc, char *argv[])
{
    static o2_monitor monitor;
    static char line[4096];
    char *cell[MOST_COLUMNS];
    int place[MOST_COLUMNS];
    o2_sample sample = {.quality = O2_GOOD};
    o2_result result = {.fault_flag = false};
    FILE *file = (argc == 2) ? fopen(argv[1], "r") : NULL;
    if ((file == NULL) || (fgets(line, (int)sizeof(line), file) == NULL)) {
        fprintf(stderr, "example: %s\n", (argc == 2) ? "cannot read the table" : "give TABLE.csv");
        return 2;
    }
    int n = cells(line, cell);
    for (int i = 0; i < n; i++) {
        place[i] = place_of(cell[i]);
    }
    if (!has_output(n, place)) {
        return 2;
    }
    o2_init(&monitor, &o2_any_vehicle);
    long tick = 0, enabled = 0;
    for (; fgets(line, (int)sizeof(line), file) != NULL; tick++) {
        int found = cells(line, cell);
        fill(&sample, cell, (found < n) ? found : n, place);
        o2_step(&monitor, &sample, &result);
        enabled += result.enabled ? 1 : 0;
        print(&monitor, &result, tick);
    }
    (void)fclose(file);
    printf("%ld of %ld samples enabled, fault flag %d\n", enabled, tick, result.fault_flag ? 1 : 0);
    return result.fault_flag ? 1 : 0;
}
