/* The exported monitor beside an engine ECU on SocketCAN.
 *
 * Reads the frames of o2_ecu.dbc from a bus, makes samples of them by the kernel's receive times,
 * calls o2_step with each and sends O2MON_Status of o2_monitor.dbc.
 *
 *     on_can can0 [can1]       can1: the bus to send on, else can0
 *     on_can - < drive.log     a log of candump -L; the frames to send are printed in its format
 *
 * Build it with the folder o2c that o2mon export-c has written, in examples/controller:
 *
 *     cc -std=c99 -O2 -Io2c -o on_can on_can.c ecu_grid.c o2c/o2_*.c -lm
 */
#define _DEFAULT_SOURCE
#include <inttypes.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <math.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "ecu_grid.h"

#define SECOND_NS INT64_C(1000000000)
#define BEHIND_NS (SECOND_NS / 10) /* so far time lags on a silent bus */
#define SILENCE_MS 500

static o2_monitor monitor;
static int out = -1; /* socket to send on, below 0 where frames are printed */

/* Return what the codes say in O2MON_Status; the lamp is the event memory's. */
static uint64_t codes_now(void)
{
    static const char letters[] = "PCBU";
    uint64_t n = 0U, code = 0U, status = 0U;
    bool is_complete = (monitor.status[O2_CODE_P0133] & O2_NOT_COMPLETED_THIS_CYCLE) == 0U;
    for (unsigned c = O2_N_CODES; c-- > 0U;) {
        if ((monitor.status[c] & O2_PENDING) != 0U) {
            const char *name = o2_code_names[c];
            code = (uint64_t)(strchr(letters, name[0]) - letters) << 14;
            code |= strtoul(&name[1], NULL, 16);
            status = monitor.status[c];
            n++;
        }
    }
    return ((n > 0U) ? 1U | (4U << 2) : is_complete ? 3U << 2 : 0U) | (n << 6) | (code << 12) |
           (status << 28);
}

/* Judge a sample and send O2MON_Status with the codes as they stand before it, as o2mon run does. */
void on_sample(const o2_sample *sample, int64_t t_ns)
{
    static uint64_t samples, enabled;
    struct can_frame frame = {.can_id = 0x5C0, .can_dlc = 8};
    uint64_t payload = codes_now();
    o2_result result;
    o2_step(&monitor, sample, &result);
    enabled += result.enabled ? 1U : 0U;
    if (((payload >> 2) & 15U) == 0U) {
        payload |= (isnan(result.predicted) ? 0U : result.enabled ? 2U : 1U) << 2;
    }
    payload |= ((100U * enabled / (samples + 1U)) << 36) | ((samples % 16U) << 52);
    samples++;
    for (int i = 0; i < 7; i++) {
        frame.data[i] = (uint8_t)(payload >> (8 * i));
    }
    frame.data[7] = ecu_checksum(frame.can_id, frame.data);
    if (out < 0) {
        printf("(%" PRId64 ".%06" PRId64 ") can0 %03X#", t_ns / SECOND_NS,
               t_ns % SECOND_NS / 1000, frame.can_id);
        for (int i = 0; i < 8; i++) {
            printf("%02X%s", frame.data[i], (i < 7) ? "" : "\n");
        }
    } else if (write(out, &frame, sizeof(frame)) < 0) {
        perror("on_can: not sent");
    }
}

static int opened(const char *bus)
{
    struct sockaddr_can address = {.can_family = AF_CAN, .can_ifindex = (int)if_nametoindex(bus)};
    int made = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if ((made < 0) || (address.can_ifindex == 0) ||
        (bind(made, (const struct sockaddr *)&address, sizeof(address)) != 0)) {
        perror(bus);
        exit(2);
    }
    return made;
}

/* Receive from a bus until it fails. */
static void listen_on(int in)
{
    struct can_filter filters[ECU_N_MESSAGES];
    struct can_frame frame;
    union {
        struct cmsghdr first;
        char bytes[CMSG_SPACE(sizeof(struct timespec))];
    } control;
    struct iovec part = {&frame, sizeof(frame)};
    struct timespec t;
    bool is_begun = false;
    int on = 1;
    for (unsigned i = 0U; i < ECU_N_MESSAGES; i++) {
        filters[i].can_id = ecu_ids[i];
        filters[i].can_mask = CAN_SFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG;
    }
    (void)setsockopt(in, SOL_CAN_RAW, CAN_RAW_FILTER, filters, sizeof(filters));
    (void)setsockopt(in, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof(on));
    for (;;) {
        struct pollfd waits = {.fd = in, .events = POLLIN};
        struct msghdr message = {.msg_iov = &part, .msg_iovlen = 1, .msg_control = &control,
                                 .msg_controllen = sizeof(control)};
        if (poll(&waits, 1, SILENCE_MS) == 0) { /* time goes on without frames */
            (void)clock_gettime(CLOCK_REALTIME, &t);
            (void)(is_begun && ecu_move_to(t.tv_sec * SECOND_NS + t.tv_nsec - BEHIND_NS));
        } else if ((recvmsg(in, &message, 0) == (ssize_t)sizeof(frame)) &&
                   (CMSG_FIRSTHDR(&message) != NULL)) {
            (void)memcpy(&t, CMSG_DATA(CMSG_FIRSTHDR(&message)), sizeof(t));
            is_begun = true;
            ecu_take(frame.can_id, frame.data, frame.can_dlc, t.tv_sec * SECOND_NS + t.tv_nsec);
        } else {
            perror("on_can: receive");
            exit(1);
        }
    }
}

static void read_log(void)
{
    char line[256], id[9], hex[17];
    int64_t s, us;
    while (fgets(line, (int)sizeof(line), stdin) != NULL) {
        struct can_frame frame = {.can_dlc = 0};
        if (sscanf(line, "(%" SCNd64 ".%" SCNd64 ") %*s %8[0-9A-F]#%16s", &s, &us, id, hex) == 4) {
            frame.can_id = (canid_t)strtoul(id, NULL, 16) | ((strlen(id) > 3U) ? CAN_EFF_FLAG : 0U);
            while ((frame.can_dlc < 8U) &&
                   (sscanf(&hex[2U * frame.can_dlc], "%2hhx", &frame.data[frame.can_dlc]) == 1)) {
                frame.can_dlc++;
            }
            ecu_take(frame.can_id, frame.data, frame.can_dlc, s * SECOND_NS + us * 1000);
        }
    }
}

int main(int argc, char *argv[])
{
    if ((argc < 2) || (argc > 3)) {
        fputs("usage: on_can can0 [can1] | on_can - < drive.log\n", stderr);
        return 2;
    }
    ecu_init();
    o2_init(&monitor, &o2_any_vehicle);
    if (strcmp(argv[1], "-") == 0) {
        read_log();
    } else {
        out = opened(argv[argc - 1]);
        (void)setsockopt(out, SOL_CAN_RAW, CAN_RAW_FILTER, NULL, 0); /* it receives nothing */
        listen_on(opened(argv[1]));
    }
    return 0;
}
