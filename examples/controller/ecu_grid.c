/* See ecu_grid.h. */
#include <math.h>
#include <string.h>

#include "ecu_grid.h"

#define JUMP_NS INT64_C(60000000000) /* behind a longer pause the grid begins anew */
#define N(array) (sizeof(array) / sizeof((array)[0]))

/* o2_ecu.dbc and o2_ecu.toml: every signal lies in little-endian order and has no sign. */
static const struct {
    const char *name;
    uint32_t id;
    unsigned start, length; /* bits */
    double factor, offset, timeout_s;
} signals[] = {
    {"air_mass_mg", 0xC0, 0, 17, 0.02, 0, 0.3},
    {"maf_kg_h", 0xC0, 17, 17, 0.01, 0, 0.3},
    {"manifold_pressure_kpa", 0xC0, 34, 16, 0.01, 0, 0.3},
    {"fuel_mass_mg", 0xC1, 0, 17, 0.002, 0, 0.3},
    {"rail_pressure_mpa", 0xC1, 17, 16, 0.001, 0, 0.3},
    {"lambda_controller", 0xC1, 33, 14, 0.0001, 0, 0.3},
    {"lambda_measured", 0xC2, 0, 16, 1.0 / 4096, 0, 0.3},
    {"closed_loop", 0xC2, 32, 2, 1, 0, 0.3},
    {"fuel_cut", 0xC2, 34, 2, 1, 0, 0.3},
    {"sensor_ready", 0xC2, 36, 2, 1, 0, 0.3},
    {"sensor_heater_percent", 0xC2, 38, 12, 0.025, 0, 0.3},
    {"engine_speed_rpm", 0xC8, 0, 16, 0.25, 0, 0.5},
    {"vehicle_speed_km_h", 0x1A0, 0, 16, 0.01, 0, 1},
    {"manifold_temperature_degc", 0x2A0, 0, 14, 0.0125, -50, 1},
    {"coolant_temperature_degc", 0x2A0, 14, 14, 0.0125, -50, 1},
    {"ambient_pressure_kpa", 0x2A1, 0, 14, 0.01, 0, 1},
    {"purge_duty_percent", 0x2A1, 28, 12, 0.025, 0, 1},
};

static struct { /* of each signal */
    int place;                 /* in a sample, below 0 where the monitor does not take it */
    double sum, held;          /* of good values in the open tick; the last tick's mean */
    unsigned n_good, n_bad;    /* values in the open tick */
    uint8_t bad, held_quality; /* O2_INVALID or O2_OUT_OF_RANGE in the open tick; of the last tick */
    int64_t heard_ns;
} channels[N(signals)];

const uint32_t ecu_ids[ECU_N_MESSAGES] = {0xC0, 0xC1, 0xC2, 0xC8, 0x1A0, 0x2A0, 0x2A1};
static int counters[ECU_N_MESSAGES]; /* of the last frame of each whose checksum held, -1 before */

static int64_t anchor_ns, newest_ns, tick; /* the open tick begins at anchor + tick * period */
static bool is_begun;

uint8_t ecu_checksum(uint32_t id, const uint8_t data[8])
{
    unsigned crc = 0xFFU;
    for (int i = -1; i < 7; i++) {
        crc ^= (i < 0) ? (id & 0xFFU) : data[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = ((crc << 1) ^ (((crc & 0x80U) != 0U) ? 0x1DU : 0U)) & 0xFFU;
        }
    }
    return (uint8_t)(crc ^ 0xFFU);
}

static uint64_t bits_of(const uint8_t data[8], unsigned start, unsigned length)
{
    uint64_t payload = 0U;
    for (int i = 7; i >= 0; i--) {
        payload = (payload << 8) | data[i];
    }
    return (payload >> start) & ((UINT64_C(1) << length) - 1U);
}

/* Hand over the sample that the signals hold. */
static void step(int64_t t_ns)
{
    o2_sample sample = {.quality = O2_STALE};
    for (unsigned i = 0U; i < O2_N_SIGNALS; i++) {
        sample.value[i] = NAN;
    }
    for (unsigned i = 0U; i < N(signals); i++) {
        if (channels[i].place >= 0) {
            sample.value[channels[i].place] = (float)channels[i].held;
        }
        if (channels[i].place == (int)O2_OUTPUT) {
            sample.quality = channels[i].held_quality;
        }
    }
    on_sample(&sample, t_ns);
}

/* Close the open tick: the mean of its good values, else the last tick's until it is too old. */
static void close_tick(void)
{
    int64_t end_ns = anchor_ns + (tick + 1) * O2_PERIOD_NS;
    for (unsigned i = 0U; i < N(signals); i++) {
        if (channels[i].n_good + channels[i].n_bad > 0U) {
            channels[i].held = (channels[i].n_good > 0U) ? channels[i].sum / channels[i].n_good : NAN;
            channels[i].held_quality = (channels[i].n_good > 0U) ? O2_GOOD : channels[i].bad;
        } else if ((double)(end_ns - channels[i].heard_ns) > signals[i].timeout_s * 1e9) {
            channels[i].held = NAN;
            channels[i].held_quality = O2_STALE;
        }
        channels[i].sum = 0.0;
        channels[i].n_good = channels[i].n_bad = 0U;
        channels[i].bad = O2_GOOD;
    }
    tick++;
    step(end_ns);
}

/* Begin the grid at the first frame, and behind a long pause, which a sample without values marks. */
static void begin(int64_t t_ns)
{
    if (is_begun) {
        close_tick();
    }
    for (unsigned i = 0U; i < N(signals); i++) {
        channels[i].held = NAN;
        channels[i].held_quality = O2_STALE;
    }
    if (is_begun) {
        step(t_ns);
    }
    is_begun = true;
    anchor_ns = newest_ns = t_ns;
    tick = 0;
}

bool ecu_move_to(int64_t t_ns)
{
    if (!is_begun || (t_ns - newest_ns > JUMP_NS)) {
        begin(t_ns);
    }
    while (t_ns > anchor_ns + (tick + 1) * O2_PERIOD_NS) {
        close_tick();
    }
    newest_ns = (t_ns > newest_ns) ? t_ns : newest_ns;
    return t_ns >= anchor_ns + tick * O2_PERIOD_NS + ((tick > 0) ? 1 : 0);
}

void ecu_take(uint32_t id, const uint8_t data[8], unsigned length, int64_t t_ns)
{
    bool is_in_time = ecu_move_to(t_ns);
    if ((length != 8U) || (ecu_checksum(id, data) != data[7])) {
        return;
    }
    for (unsigned i = 0U; i < ECU_N_MESSAGES; i++) {
        if (ecu_ids[i] == id) {
            int count = (int)bits_of(data, 52U, 4U);
            is_in_time = is_in_time && (count != counters[i]); /* one that stands repeats a frame */
            counters[i] = count;
        }
    }
    for (unsigned i = 0U; is_in_time && (i < N(signals)); i++) {
        if ((signals[i].id == id) && (channels[i].place >= 0)) {
            uint64_t raw = bits_of(data, signals[i].start, signals[i].length);
            double value = (double)raw * signals[i].factor + signals[i].offset;
            o2_bounds range = o2_plausible[channels[i].place];
            bool is_missing = raw == (UINT64_C(1) << signals[i].length) - 1U; /* all bits 1 */
            channels[i].heard_ns = t_ns;
            if (!is_missing && ((float)value >= range.low) && ((float)value <= range.high)) {
                channels[i].n_good++;
                channels[i].sum += value;
            } else {
                channels[i].n_bad++;
                channels[i].bad = (is_missing && (channels[i].bad != O2_OUT_OF_RANGE))
                                      ? O2_INVALID
                                      : O2_OUT_OF_RANGE;
            }
        }
    }
}

void ecu_init(void)
{
    is_begun = false;
    for (unsigned i = 0U; i < ECU_N_MESSAGES; i++) {
        counters[i] = -1;
    }
    for (unsigned i = 0U; i < N(signals); i++) {
        channels[i].place = -1;
        channels[i].heard_ns = INT64_MIN / 2; /* never */
        for (int place = 0; place < (int)O2_N_SIGNALS; place++) {
            if (strcmp(signals[i].name, o2_signal_names[place]) == 0) {
                channels[i].place = place;
            }
        }
    }
}
