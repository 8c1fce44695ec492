/*
 * socketcan.c - a device on a CAN interface of Linux, with the kit as in firmware.
 *
 *     cc -O2 -I src/kit -I FOLDER_OF_DES_CONFIG tests/kit/socketcan.c src/kit/des.c -o device
 *     ./device can0 [SETTINGS-FILE] [--configure]
 *
 * It has INIT with silent listening, address resolution, the heartbeat, DES, the descriptor and
 * the commands of des_config.h. Settings are 9 bytes in a file, as firmware has them in flash.
 * With --configure (as root) it sets the bit rate and listen-only mode of a real interface with
 * the program ip; without it the interface is left as it is, and silent means that nothing is
 * sent. Linux has no single shot for one frame: a claim is repeated until it is acknowledged.
 */
#define _GNU_SOURCE
#include "des.h"

#include <linux/can.h>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/random.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#ifndef DES_NAME
#define DES_NAME "LINUX"
#define DES_SERVICES DES_SERVICE("\0", "DES", "1.0") DES_SERVICE("\1", "EXAMPLE", "0.1")
#endif

typedef struct {
    const char *interface;
    const char *settings;
    bool configures;
    bool is_silent;
    int socket;
    uint32_t errors;
    struct canfd_frame frames[2]; /* The transmit buffers. */
    bool is_pending[2];
} device;

static uint32_t now_us(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

static bool port_send(void *user, uint8_t slot, const des_frame *frame)
{
    device *own = user;
    struct canfd_frame *raw = &own->frames[slot];
    bool is_fd = (frame->flags & DES_FRAME_FD) != 0u;

    memset(raw, 0, sizeof(*raw));
    raw->can_id = frame->id | CAN_EFF_FLAG;
    raw->len = frame->length;
    raw->flags = is_fd ? CANFD_BRS : 0;
    memcpy(raw->data, frame->data, frame->length);
    own->is_pending[slot] = write(own->socket, raw, is_fd ? CANFD_MTU : CAN_MTU) > 0;
    return own->is_pending[slot];
}

static des_tx port_sent(void *user, uint8_t slot)
{
    return ((device *)user)->is_pending[slot] ? DES_TX_PENDING : DES_TX_SENT;
}

static void port_bus(void *user, uint8_t rate, bool silent)
{
    static const unsigned rates[4] = {125000u, 250000u, 500000u, 1000000u};
    device *own = user;
    char command[256];

    own->is_silent = silent;
    own->errors = 0u;
    own->is_pending[0] = false;
    own->is_pending[1] = false;
    printf("bus: %u bit/s%s\n", rates[rate], silent ? ", silent" : "");
    if (own->configures) {
        snprintf(command, sizeof(command),
                 "ip link set %s down; ip link set %s type can bitrate %u listen-only %s "
                 "berr-reporting on; ip link set %s up",
                 own->interface, own->interface, rates[rate], silent ? "on" : "off",
                 own->interface);
        if (system(command) != 0) {
            fprintf(stderr, "failed: %s\n", command);
        }
    }
}

static uint32_t port_errors(void *user)
{
    device *own = user;
    uint32_t errors = own->errors;

    own->errors &= ~DES_ERROR_SEEN;
    return errors;
}

static uint32_t port_entropy(void *user)
{
    uint32_t bits = 0u;

    (void)user;
    if (getrandom(&bits, sizeof(bits), 0) < 0) {
        bits = now_us();
    }
    return bits;
}

static void port_load(void *user, des_settings *settings)
{
    static const des_settings blank = DES_SETTINGS_BLANK;
    device *own = user;
    FILE *file = own->settings == NULL ? NULL : fopen(own->settings, "rb");

    if (file == NULL || fread(settings, sizeof(*settings), 1, file) != 1) {
        *settings = blank;
    }
    if (file != NULL) {
        fclose(file);
    }
}

static bool port_store(void *user, const des_settings *settings)
{
    device *own = user;
    FILE *file = own->settings == NULL ? NULL : fopen(own->settings, "wb");
    bool is_written = file != NULL && fwrite(settings, sizeof(*settings), 1, file) == 1;

    if (file != NULL) {
        is_written = fclose(file) == 0 && is_written;
    }
    return is_written;
}

static void port_event(void *user, des_event event, uint8_t value)
{
    static const char *const names[] = {"mode", "identify", "reboot"};

    (void)user;
    printf("%s %u\n", names[event], value);
}

static const des_port PORT = {port_send,    port_sent, port_bus,   port_errors,
                              port_entropy, port_load, port_store, port_event};
static const des_device DEVICE = {
    DES_NAME_TEXT(DES_NAME), DES_SERVICES_TEXT(DES_SERVICES),
    DES_INFO((0x4C, 0x49, 0x4E, 0x55, 0x58, 0x01), 1u, 0u, 1u, 0u, 0u, 0u)};

static int open_interface(const char *name)
{
    int one = 1;
    can_err_mask_t errors = CAN_ERR_MASK;
    struct sockaddr_can address = {0};
    int raw = socket(PF_CAN, SOCK_RAW, CAN_RAW);

    address.can_family = AF_CAN;
    address.can_ifindex = (int)if_nametoindex(name);
    if (raw < 0 || address.can_ifindex == 0
        || bind(raw, (struct sockaddr *)&address, sizeof(address)) != 0) {
        perror(name);
        exit(1);
    }
    /* Own frames come back when they were sent: that is how `sent` knows. */
    setsockopt(raw, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &one, sizeof(one));
    setsockopt(raw, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &one, sizeof(one));
    setsockopt(raw, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof(errors));
    return raw;
}

/* Handles an error frame: the counters, and that there was an error. */
static void note_error(device *own, const struct canfd_frame *raw)
{
    uint32_t counter = raw->data[6] > raw->data[7] ? raw->data[6] : raw->data[7];

    if ((raw->can_id & CAN_ERR_BUSOFF) != 0u) {
        counter = 256u;
    }
    if ((raw->can_id & (CAN_ERR_CRTL | CAN_ERR_BUSOFF | CAN_ERR_CNT)) != 0u) {
        own->errors = (own->errors & DES_ERROR_SEEN) | counter;
    }
    if ((raw->can_id & (CAN_ERR_PROT | CAN_ERR_BUSERROR)) != 0u) {
        own->errors |= DES_ERROR_SEEN;
    }
}

/* Reads what was received, until nothing is left. */
static void receive(device *own, des_node *node)
{
    for (;;) {
        struct canfd_frame raw;
        struct iovec part = {&raw, sizeof(raw)};
        struct msghdr message = {0};
        ssize_t size;

        message.msg_iov = &part;
        message.msg_iovlen = 1;
        size = recvmsg(own->socket, &message, MSG_DONTWAIT);
        if (size <= 0) {
            return;
        }
        if ((raw.can_id & CAN_ERR_FLAG) != 0u) {
            note_error(own, &raw);
        } else if ((message.msg_flags & MSG_CONFIRM) != 0) {
            int slot;

            for (slot = 0; slot < 2; slot++) {
                if (own->is_pending[slot] && own->frames[slot].can_id == raw.can_id) {
                    own->is_pending[slot] = false;
                }
            }
        } else if ((raw.can_id & CAN_EFF_FLAG) != 0u && (raw.can_id & CAN_RTR_FLAG) == 0u) {
            des_frame frame = {raw.can_id & CAN_EFF_MASK, raw.data, raw.len, 0u};

            if (size == CANFD_MTU) {
                frame.flags = DES_FRAME_FD;
            }
            if (des_receive(node, &frame, now_us())) {
                printf("for the application: %08X\n", frame.id);
            }
        } else {
            /* Not of the platform. */
        }
    }
}

int main(int count, char **arguments)
{
    static des_node node;
    static device own;
    int at;

    for (at = 1; at < count; at++) {
        if (strcmp(arguments[at], "--configure") == 0) {
            own.configures = true;
        } else if (own.interface == NULL) {
            own.interface = arguments[at];
        } else {
            own.settings = arguments[at];
        }
    }
    if (own.interface == NULL) {
        fprintf(stderr, "usage: %s INTERFACE [SETTINGS-FILE] [--configure]\n", arguments[0]);
        return 2;
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    own.socket = open_interface(own.interface);
    des_init(&node, &PORT, &DEVICE, &own);
    for (;;) {
        uint32_t wait = des_poll(&node, now_us());
        struct pollfd input = {own.socket, POLLIN, 0};

        poll(&input, 1, (int)((wait + 999u) / 1000u));
        receive(&own, &node);
    }
}
