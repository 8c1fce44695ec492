/*
 * fuzz.c - random frames, results, errors and times for a node of the kit.
 *
 *     cc -g -O1 -fsanitize=address,undefined -fno-sanitize-recover=all \
 *         -I src/kit -I FOLDER_OF_DES_CONFIG tests/kit/fuzz.c src/kit/des.c -o fuzz
 *     ./fuzz 10000000 1
 *
 * Arguments: the number of calls, and a seed. Frames are mostly near to valid ones: for the
 * node's address, of its services, DES requests and flow control. Checks what must always
 * hold: at most one frame in a transmit buffer, nothing sent while silent, identifiers with
 * the node's address, lengths of a DLC, and a next call within a heartbeat period.
 */
#include "des.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    des_node node;
    des_settings stored;
    bool is_silent;
    bool is_busy[2];
    uint32_t sent;
} board;

static uint64_t random_state;

static uint32_t next(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 32);
}

static uint32_t below(uint32_t range)
{
    return next() % range;
}

#define CHECK(condition)                                                                  \
    do {                                                                                  \
        if (!(condition)) {                                                               \
            fprintf(stderr, "%s:%d: violated: %s\n", __FILE__, __LINE__, #condition);     \
            abort();                                                                      \
        }                                                                                 \
    } while (0)

static bool port_send(void *user, uint8_t slot, const des_frame *frame)
{
    board *own = user;
    bool is_fd = (frame->flags & DES_FRAME_FD) != 0u;
    bool is_fd_length = frame->length == 12u || frame->length == 16u || frame->length == 20u
        || frame->length == 24u || frame->length == 32u || frame->length == 48u
        || frame->length == 64u;
    volatile uint8_t sum = 0u;
    uint8_t at;

    CHECK(slot < 2u && !own->is_busy[slot]);
    CHECK(!own->is_silent);
    CHECK(frame->length <= 8u || (is_fd && is_fd_length));
    CHECK(des_id_is_conforming(frame->id) && (frame->id & DES_ID_R) != 0u);
    CHECK(des_id_source(frame->id) == des_id_source(own->node.own) && des_id_source(own->node.own) != 0u);
    for (at = 0u; at < frame->length; at++) {
        sum = (uint8_t)(sum + frame->data[at]);
    }
    if (below(8u) == 0u) {
        return false;
    }
    own->is_busy[slot] = true;
    own->sent++;
    return true;
}

static des_tx port_sent(void *user, uint8_t slot)
{
    board *own = user;
    uint32_t dice = below(16u);

    CHECK(own->is_busy[slot]);
    if (dice < 4u) {
        return DES_TX_PENDING;
    }
    own->is_busy[slot] = false;
    return dice < 15u ? DES_TX_SENT : DES_TX_FAILED;
}

static void port_bus(void *user, uint8_t rate, bool silent)
{
    board *own = user;

    CHECK(rate < 4u);
    own->is_silent = silent;
    own->is_busy[0] = false;
    own->is_busy[1] = false;
}

static uint32_t port_errors(void *user)
{
    (void)user;
    return below(20000u) == 0u ? below(1024u) : below(100u);
}

static uint32_t port_entropy(void *user)
{
    (void)user;
    return next();
}

static void port_load(void *user, des_settings *settings)
{
    *settings = ((board *)user)->stored;
}

static bool port_store(void *user, const des_settings *settings)
{
    ((board *)user)->stored = *settings;
    return below(8u) != 0u;
}

static void port_event(void *user, des_event event, uint8_t value)
{
    (void)user;
    CHECK(event <= DES_EVENT_REBOOT && value <= 6u);
}

static const des_port PORT = {port_send,    port_sent, port_bus,   port_errors,
                              port_entropy, port_load, port_store, port_event};

#define LONG_NAME "A NAME THAT IS LONGER THAN ONE FRAME, AND THAN A SINGLE FRAME OF CAN FD TOO"
#define SERVICES                                                                          \
    DES_SERVICE("\0", "DES", "1.0")                                                       \
    DES_SERVICE("\1", "AUGER", "2.1") DES_SERVICE("\2", "A SERVICE", "WITH A LONG VERSION")

/* Writes a random frame. The data are in memory of exactly their length. */
static void random_frame(const board *own, des_frame *frame)
{
    static const uint16_t services[] = {DES_SRV_DES, DES_SRV_HEARTBEAT, 0x10, 0x11, 0x12, 0x13,
                                        0x14, 0x15, 0x16, 0x17, 0x18, 0x19, 0x1A, 0x1B};
    static const uint8_t texts[][6] = {{4, 'D', 'E', 'S', 1, 0},    {4, 'D', 'E', 'S', 2, 0},
                                       {'D', 'E', 'S', 1, 0, 0},    {'D', 'E', 'S', 2, 0, 0},
                                       {0x30, 0, 0, 0, 0, 0},       {0x30, 3, 0xF3, 0, 0, 0},
                                       {0x31, 0, 0, 0, 0, 0},       {0x32, 0, 0, 0, 0, 0},
                                       {0, 4, 'D', 'E', 'S', 1}};
    static const uint8_t lengths[] = {12, 16, 20, 24, 32, 48, 64};
    uint8_t length = (uint8_t)below(9u);
    uint8_t *data;
    uint8_t at;

    frame->flags = below(4u) == 0u ? DES_FRAME_FD : 0u;
    if (frame->flags != 0u && below(2u) == 0u) {
        length = lengths[below(7u)];
    }
    data = malloc(length == 0u ? 1u : length);
    for (at = 0u; at < length; at++) {
        data[at] = (uint8_t)(below(4u) == 0u ? below(8u) : next());
    }
    frame->id = next() & 0x1FFFFFFFu;
    if (below(8u) != 0u) {
        bool is_request = below(4u) != 0u;

        frame->id = is_request ? (next() & (DES_ID_D | DES_ID_B)) : (frame->id & ~DES_ID_D);
        frame->id |= (below(4u) == 0u ? des_id_source(own->node.own) : below(6u)) << 17;
        frame->id &= ~((uint32_t)0x7Fu << 10);
        frame->id |= (below(4u) != 0u ? des_id_source(own->node.own) : below(128u)) << 10;
        frame->id &= ~(uint32_t)0x3FFu;
        frame->id |= services[below(2u) * below(sizeof(services) / sizeof(services[0]))];
        if (below(1000u) != 0u && des_id_source(frame->id) == des_id_source(own->node.own)) {
            frame->id ^= (uint32_t)0x40u << 17; /* Seldom a conflict. */
        }
    }
    if (below(2u) == 0u) {
        const uint8_t *text = texts[below(sizeof(texts) / sizeof(texts[0]))];

        for (at = 0u; at < length && at < 6u; at++) {
            data[at] = text[at];
        }
    } else if (below(8u) == 0u) {
        for (at = 0u; at < length && at < 6u; at++) {
            data[at] = own->stored.uid[at];
        }
    }
    frame->data = data;
    frame->length = length;
}

int main(int count, char **arguments)
{
    static const des_device device = {DES_NAME_TEXT(LONG_NAME), DES_SERVICES_TEXT(SERVICES), {0}};
    unsigned long calls = count > 1 ? strtoul(arguments[1], NULL, 10) : 1000000ul;
    uint32_t now;
    board *own = malloc(sizeof(*own));
    unsigned long call;
    uint32_t total = 0u;

    random_state = 0x9E3779B97F4A7C15ull ^ (count > 2 ? strtoul(arguments[2], NULL, 10) : 1ul);
    now = next();
    memset(own, 0x5A, sizeof(*own));
    own->sent = 0u;
    for (call = 0u; call < calls; call++) {
        uint32_t dice = below(1000u);

        if (call == 0u || (dice == 0u && below(50u) == 0u)) {
            uint8_t at;

            for (at = 0u; at < 6u; at++) {
                own->stored.uid[at] = (uint8_t)(below(2u) == 0u ? 0u : next());
            }
            own->stored.address = (uint8_t)below(256u);
            own->stored.bitrate = (uint8_t)(below(4u) | (below(4u) == 0u ? 0u : 0x80u));
            own->stored.autostart = (uint8_t)below(2u);
            own->is_silent = true; /* Nothing is sent before the controller is set up. */
            des_init(&own->node, &PORT, &device, own);
        } else if (dice < 4u && below(20u) == 0u) {
            des_set_mode(&own->node, (des_mode)below(7u));
        } else if (dice == 4u && below(20u) == 0u) {
            des_set_limit(&own->node, (des_mode)(below(4u) == 0u ? 2u + below(2u) : 4u));
        } else if (dice == 5u) {
            des_set_error(&own->node, (uint8_t)below(2u));
        } else if (dice < (des_get_address(&own->node) != 0u ? 600u : 20u)) {
            des_frame frame;

            random_frame(own, &frame);
            (void)des_receive(&own->node, &frame, now);
            free((void *)(uintptr_t)frame.data);
        } else {
            uint32_t wait = des_poll(&own->node, now);

            CHECK(wait > 0u && wait <= DES_HEARTBEAT_MS * 1000u);
            if (des_get_address(&own->node) == 0u) {
                wait = below(300000u); /* Address resolution takes seconds. */
            }
            now += below(4u) == 0u ? wait : below(2000u);
        }
        if (own->sent > 0u) {
            total += own->sent;
            own->sent = 0u;
        }
    }
    printf("%lu calls, %u frames sent, %u requests dropped (modulo 256)\n", calls, total,
           own->node.dropped);
    free(own);
    return 0;
}
