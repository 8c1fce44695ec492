/*
 * driver.c - runs nodes of the kit for a test program, without a clock or a bus.
 *
 * Commands on standard input, one a line, each with the number of a node, 0 to 127:
 *
 *     node N NAME SERVICES UID ADDRESS BITRATE AUTOSTART ENTROPY
 *                        sets what node N is, in hexadecimal digits ("-": none)
 *     time T             sets the time, microseconds modulo 2^32
 *     init N             des_init
 *     frame N ID DATA FD des_receive of a frame; prints "app" if it returns true
 *     poll N             des_poll; prints "wait MICROSECONDS"
 *     result N SLOT R    what became of a transmit buffer: 0 pending, 1 sent, 2 failed
 *     errors N VALUE     what the function `errors` returns, until the next call of bus
 *     refuse N B         1: the transmit buffers take no frame
 *     locked N B         1: settings cannot be stored
 *     mode N M           des_set_mode
 *     limit N M          des_set_limit
 *     fault N E          des_set_error
 *     dropped N          prints "dropped COUNT"
 *     filters N ID       prints "passes" if the node's filters pass an identifier
 *     step N T E R0 R1 [ID DATA FD]
 *                        one turn of a main loop: `time T`, `errors N E`, `result N 0 R0` and
 *                        `result N 1 R1`, `frame N ID DATA FD` if there is one, `poll N`
 *     id ID              prints SRC, DST, SRV and whether it conforms
 *
 * The answer is what the node did, one line each, and "ok":
 *
 *     tx SLOT ID DATA FD ONCE    bus RATE SILENT    event EVENT VALUE    store UID ADDRESS BITRATE
 */
#include "des.h"

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define NODES 128

typedef struct {
    des_node node;
    des_device device;
    des_settings settings;
    uint32_t entropy;
    uint32_t errors;
    des_tx results[2];
    bool refuses;
    bool is_locked;
    char name[4098];
    char services[4098];
} board;

static board boards[NODES];
static uint32_t now;

static unsigned from_hex(const char *text, char *bytes)
{
    unsigned count = 0;

    if (strcmp(text, "-") == 0) {
        return 0;
    }
    for (; text[0] != '\0' && text[1] != '\0'; text += 2) {
        char digits[3] = {text[0], text[1], '\0'};

        bytes[count++] = (char)strtoul(digits, NULL, 16);
    }
    return count;
}

static void print_hex(const uint8_t *bytes, unsigned count)
{
    unsigned at;

    if (count == 0) {
        printf("-");
    }
    for (at = 0; at < count; at++) {
        printf("%02X", bytes[at]);
    }
}

static bool port_send(void *user, uint8_t slot, const des_frame *frame)
{
    board *own = user;

    if (own->refuses) {
        return false;
    }
    own->results[slot] = DES_TX_PENDING;
    printf("tx %u %08" PRIX32 " ", slot, frame->id);
    print_hex(frame->data, frame->length);
    printf(" %d %d\n", (frame->flags & DES_FRAME_FD) != 0, (frame->flags & DES_FRAME_ONCE) != 0);
    return true;
}

static des_tx port_sent(void *user, uint8_t slot)
{
    return ((board *)user)->results[slot];
}

static void port_bus(void *user, uint8_t rate, bool silent)
{
    ((board *)user)->errors = 0;
    printf("bus %u %d\n", rate, silent);
}

static uint32_t port_errors(void *user)
{
    board *own = user;
    uint32_t errors = own->errors;

    own->errors &= ~DES_ERROR_SEEN;
    return errors;
}

static uint32_t port_entropy(void *user)
{
    return ((board *)user)->entropy;
}

static void port_load(void *user, des_settings *settings)
{
    *settings = ((board *)user)->settings;
}

static bool port_store(void *user, const des_settings *settings)
{
    board *own = user;

    if (own->is_locked) {
        return false;
    }
    own->settings = *settings;
    printf("store ");
    print_hex(settings->uid, 6);
    printf(" %02X %02X\n", settings->address, settings->bitrate);
    return true;
}

static void port_event(void *user, des_event event, uint8_t value)
{
    (void)user;
    printf("event %d %u\n", (int)event, value);
}

static const des_port PORT = {port_send,    port_sent, port_bus,   port_errors,
                              port_entropy, port_load, port_store, port_event};
static const des_device DEVICE = {
    .info = DES_INFO((1, 2, 3, 4, 5, 6), 0x11223344u, 0x0102u, 0x0304u, 3, 0x0001u, 0x8002u)};

static void set_up(board *own, char **words)
{
    char bytes[4096] = {0};
    des_device device = DEVICE;

    memset(own, 0, sizeof(*own));
    own->name[0] = 1;
    own->services[0] = 2;
    device.name.bytes = own->name;
    device.name.size = (uint16_t)(from_hex(words[0], &own->name[1]) + 2u);
    device.services.bytes = own->services;
    device.services.size = (uint16_t)(from_hex(words[1], &own->services[1]) + 1u);
    memcpy(&own->device, &device, sizeof(device));
    (void)from_hex(words[2], bytes);
    memcpy(own->settings.uid, bytes, 6);
    own->settings.address = (uint8_t)strtoul(words[3], NULL, 16);
    own->settings.bitrate = (uint8_t)strtoul(words[4], NULL, 16);
    own->settings.autostart = (uint8_t)strtoul(words[5], NULL, 16);
    own->entropy = (uint32_t)strtoul(words[6], NULL, 16);
}

static void receive(board *own, char **words)
{
    char bytes[64] = {0};
    des_frame frame;

    frame.id = (uint32_t)strtoul(words[0], NULL, 16);
    frame.length = (uint8_t)from_hex(words[1], bytes);
    frame.data = (const uint8_t *)bytes;
    frame.flags = strcmp(words[2], "1") == 0 ? DES_FRAME_FD : 0u;
    if (des_receive(&own->node, &frame, now)) {
        printf("app\n");
    }
}

static bool passes(const board *own, uint32_t id)
{
    des_filter filters[5];
    uint8_t count = des_filters(des_get_address(&own->node), filters);
    uint8_t at;

    for (at = 0; at < count; at++) {
        if ((id & filters[at].mask) == filters[at].id) {
            return true;
        }
    }
    return false;
}

static void run(char **words)
{
    const char *verb = words[0];
    unsigned long number = strtoul(words[1], NULL, verb[0] == 'i' && verb[1] == 'd' ? 16 : 10);
    board *own = &boards[number % NODES];
    uint32_t value = (uint32_t)strtoul(words[2], NULL, 10);

    if (strcmp(verb, "node") == 0) {
        set_up(own, &words[2]);
    } else if (strcmp(verb, "time") == 0) {
        now = (uint32_t)number;
    } else if (strcmp(verb, "init") == 0) {
        des_init(&own->node, &PORT, &own->device, own);
    } else if (strcmp(verb, "frame") == 0) {
        receive(own, &words[2]);
    } else if (strcmp(verb, "poll") == 0) {
        printf("wait %" PRIu32 "\n", des_poll(&own->node, now));
    } else if (strcmp(verb, "result") == 0) {
        own->results[value & 1u] = (des_tx)strtoul(words[3], NULL, 10);
    } else if (strcmp(verb, "errors") == 0) {
        own->errors = value;
    } else if (strcmp(verb, "refuse") == 0) {
        own->refuses = value != 0;
    } else if (strcmp(verb, "locked") == 0) {
        own->is_locked = value != 0;
    } else if (strcmp(verb, "mode") == 0) {
        des_set_mode(&own->node, (des_mode)value);
    } else if (strcmp(verb, "limit") == 0) {
        des_set_limit(&own->node, (des_mode)value);
    } else if (strcmp(verb, "fault") == 0) {
        des_set_error(&own->node, (uint8_t)value);
    } else if (strcmp(verb, "dropped") == 0) {
        printf("dropped %u\n", own->node.dropped);
    } else if (strcmp(verb, "filters") == 0) {
        if (passes(own, (uint32_t)strtoul(words[2], NULL, 16))) {
            printf("passes\n");
        }
    } else if (strcmp(verb, "step") == 0) {
        now = value;
        own->errors = (uint32_t)strtoul(words[3], NULL, 10);
        own->results[0] = (des_tx)strtoul(words[4], NULL, 10);
        own->results[1] = (des_tx)strtoul(words[5], NULL, 10);
        if (words[6][0] != '\0') {
            receive(own, &words[6]);
        }
        printf("wait %" PRIu32 "\n", des_poll(&own->node, now));
    } else if (strcmp(verb, "id") == 0) {
        uint32_t id = (uint32_t)number;

        printf("%u %u %u %d\n", des_id_source(id), des_id_destination(id), des_id_service(id),
               des_id_is_conforming(id));
    } else {
        printf("unknown command\n");
    }
}

int main(void)
{
    static char line[20000];
    char empty[] = "";

    while (fgets(line, sizeof(line), stdin) != NULL) {
        char *words[10];
        char *word = strtok(line, " \n");
        unsigned count = 0;

        while (count < 10) {
            words[count++] = word == NULL ? empty : word;
            word = word == NULL ? NULL : strtok(NULL, " \n");
        }
        run(words);
        printf("ok\n");
        fflush(stdout);
    }
    return 0;
}
