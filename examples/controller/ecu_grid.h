/* Frames of o2_ecu.dbc to samples: on a controller as on a host, with its own receive times.
 *
 * Tick k ends at the first frame's time + k * O2_PERIOD_NS. Its sample holds the mean of the good
 * values received in it, else the last tick's until the signal's timeout. A sample is complete at
 * the first frame behind its end. A clock that is set back is not handled.
 */
#ifndef ECU_GRID_H
#define ECU_GRID_H

#include "o2_monitor.h"

#define ECU_N_MESSAGES 7U
extern const uint32_t ecu_ids[ECU_N_MESSAGES];

void ecu_init(void);
/* Take a frame, sound or not: its time moves the grid. */
void ecu_take(uint32_t id, const uint8_t data[8], unsigned length, int64_t t_ns);
/* Move time on, on a silent bus; return whether a frame of this time is not too late. */
bool ecu_move_to(int64_t t_ns);
/* CRC8 SAE J1850 over the identifier's low byte and bytes 0 to 6. */
uint8_t ecu_checksum(uint32_t id, const uint8_t data[8]);

/* The program's own: takes a complete sample. */
void on_sample(const o2_sample *sample, int64_t t_ns);

#endif
