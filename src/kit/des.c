/*
 * des.c - DES responder and node of the CAN platform, for firmware. See des.h.
 *
 * CAN platform 3.2.4 (modes, address resolution) and 4 (identifiers), the DES
 * service document, ISO 15765-2 (transfers, sender's side).
 *
 * SPDX-License-Identifier: MIT
 */
#include "des.h"

#define MAX_CLASSIC_DATA 8u
#define MAX_SINGLE 7u
#if DES_WITH_FD
#define MAX_DATA 64u
#define MAX_FD_SINGLE 62u
#else
#define MAX_DATA MAX_CLASSIC_DATA
#endif

/* Times in microseconds. */
#define HR_TIME (DES_HEARTBEAT_MS * UINT32_C(1000))
#define LISTEN_TIME (HR_TIME + (HR_TIME / 2u))
#define N_BS UINT32_C(1000000)
#define N_WFT_MAX 16u
/* Half of the range of the clock: what is further ahead is over. */
#define TIME_HALF UINT32_C(0x80000000)

/* Heartbeats for which a working node with the same UID is remembered. */
#define UID_MEMORY 5u

/* The frame that is sent at the end of WAIT is a claim: its flags are a bit of the stage. */
enum { STAGE_INIT, STAGE_LISTEN, STAGE_WAIT = DES_FRAME_ONCE, STAGE_CLAIM, STAGE_RUN };
enum { REQUESTER_FREE, REQUESTER_READY, REQUESTER_SENDING, REQUESTER_FLOW, REQUESTER_DONE };

/* des_node.wish: ARSLV, because another node uses the address. */
#define WISH_MOVE (0x100u | DES_MODE_ARSLV)

/* des_node.busy: one bit for each transmit buffer; and that the controller is silent. */
#define BUSY_HEARTBEAT (1u << DES_SLOT_HEARTBEAT)
#define BUSY_RESPONSE (1u << DES_SLOT_RESPONSE)
#define BUSY_ANY (BUSY_HEARTBEAT | BUSY_RESPONSE)
#define IS_SILENT 0x80u

/* SRC of an identifier. */
#define ADDRESS_MASK (UINT32_C(0x7F) << 17)

/* des_requester.pending and .current. */
#define ASK_NAME 0x0001u
#define ASK_NAME_RAW 0x0002u
#define ASK_SERVICES 0x0004u
#define ASK_SERVICES_RAW 0x0008u
#define ASK_TEXT 0x000Fu
#define ASK_COMMAND 0x0010u
#define ASK_FIELD 0x0020u /* The first field; the others follow. */

/* Bit of des_requester.service; DES_ID_ERR of the response, 9 bits higher. */
#define COMMAND_DONE 0x8000u

/* Bytes of the shortest frame with a request. */
#if DES_WITH_RAW
#define MIN_REQUEST 4u
#else
#define MIN_REQUEST 5u
#endif

/* Type bytes of requests and responses. */
#define TYPE_NAME 0x01u
#define TYPE_SERVICES 0x02u

/* Returns true if the moment `at` is not after `now`. */
static bool is_due(uint32_t at, uint32_t now)
{
    return (now - at) < TIME_HALF;
}

static void copy(uint8_t *to, const uint8_t *from, uint32_t count)
{
    uint32_t at;

    for (at = 0u; at < count; at++) {
        to[at] = from[at];
    }
}

/* ---- Random numbers ---------------------------------------------------------- */

uint32_t des_random(des_node *node)
{
    /* A linear congruential generator: its high bits are the random ones. */
    node->random = ((node->random + node->port->entropy(node->user)) * UINT32_C(0x9E3779B1))
        + UINT32_C(0x3C6EF35F);
    return node->random;
}

/* ---- Modes --------------------------------------------------------------------- */

static bool is_blank(const uint8_t *uid)
{
    uint8_t ones = 0xFFu;
    uint8_t any = 0u;
    uint32_t at;

    for (at = 0u; at < 6u; at++) {
        ones &= uid[at];
        any |= uid[at];
    }
    return (any == 0u) || (ones == 0xFFu);
}

static bool is_working_mode(uint32_t mode)
{
    return (mode == (uint32_t)DES_MODE_WORK) || (mode == (uint32_t)DES_MODE_UFUNC);
}

/* Returns the mode that the node enters for `mode`, as far as it may. */
static uint32_t permitted(const des_node *node, uint32_t mode)
{
    if (is_working_mode(mode)) {
        mode = (node->error == 0u) ? (uint32_t)DES_MODE_WORK : (uint32_t)DES_MODE_UFUNC;
        if ((node->limit != (uint32_t)DES_MODE_WORK) || (node->settings.address == 0u)
            || (node->uid_in_use != 0u) || is_blank(node->settings.uid)) {
            mode = DES_MODE_CFG;
        }
    }
    if ((mode == (uint32_t)DES_MODE_CFG) && (node->limit == (uint32_t)DES_MODE_BOOT)) {
        mode = DES_MODE_BOOT;
    }
    return mode;
}

/* Configures the controller, if it is not silent or active as it is to be. */
static void set_bus(des_node *node, uint32_t silent)
{
    if ((node->busy & IS_SILENT) != silent) {
        node->busy = silent;
        node->port->bus(node->user, node->rate, silent != 0u);
    }
}

static bool is_in_use(const des_node *node, uint32_t address)
{
    return ((node->in_use[address >> 5] >> (address & 31u)) & 1u) != 0u;
}

static void note_address(des_node *node, uint32_t address)
{
    node->in_use[address >> 5] |= UINT32_C(1) << (address & 31u);
}

/* Begins to listen for 1.5 * BUS_CFG_HR_TIME: in INIT for any frame, in ARSLV for addresses in
 * use. */
static void listen(des_node *node, bool is_init, uint32_t now)
{
    uint32_t rate = node->settings.bitrate;
    uint32_t at;

    if (is_init) {
        if (node->stage == (uint32_t)STAGE_INIT) {
            rate = node->rate + (rate >> 7); /* Bus errors: another one, unless it is fixed. */
        }
        node->rate = (uint8_t)(rate & 3u);
        node->busy = 0u; /* The controller is configured anew in any case. */
    }
    node->stage = is_init ? STAGE_INIT : STAGE_LISTEN;
    node->until = now + LISTEN_TIME;
    for (at = 0u; at < 4u; at++) {
        node->in_use[at] = 0u;
    }
    if (node->wish > 0xFFu) {
        note_address(node, des_id_source(node->own));
    }
    for (at = 0u; at < DES_REQUESTERS; at++) {
        node->requesters[at].state = REQUESTER_FREE;
    }
    node->wish = DES_MODE_CFG;
    set_bus(node, IS_SILENT);
}

/* Enters the mode that is wished, as far as it is permitted. */
static void change_mode(des_node *node, uint32_t now)
{
    uint32_t mode = permitted(node, node->wish) & 0xFFu;

    if ((mode == (uint32_t)DES_MODE_INIT) || (mode == (uint32_t)DES_MODE_ARSLV)) {
        listen(node, mode == (uint32_t)DES_MODE_INIT, now);
    } else if (node->stage == (uint32_t)STAGE_RUN) {
        node->wish = mode;
    } else {
        return;
    }
    if (node->mode != mode) {
        if (mode == (uint32_t)DES_MODE_IDLE) {
            node->until = now; /* The others learn of it before it sleeps. */
        }
        node->mode = mode;
        node->own = (node->own & ADDRESS_MASK) | (is_working_mode(mode) ? 0u : DES_ID_U);
        node->port->event(node->user, DES_EVENT_MODE, (uint8_t)mode);
    }
}

/* ARSLV: chooses an address, to be claimed after a random part of BUS_CFG_HR_TIME. Returns false
 * if it finds none that is free. */
static bool choose(des_node *node, uint32_t now)
{
    uint32_t setting = node->settings.address;
    uint32_t choice = setting & 0x7Fu;
    uint32_t tries;

    for (tries = 0u; tries < 128u; tries++) {
        if ((choice != 0u) && !is_in_use(node, choice)) {
            node->own = DES_ID_U | (choice << 17);
            node->stage = STAGE_WAIT;
            node->until = now + (((des_random(node) >> 16) * (HR_TIME >> 10)) >> 6);
            return true;
        }
        if ((setting - 1u) < 0x7Fu) {
            break; /* A fixed address. */
        }
        choice = des_random(node) >> 25;
    }
    return false;
}

/* ---- Heartbeat ------------------------------------------------------------------ */

/* Bytes of the heartbeat: up to the end of its last field. */
#define HEARTBEAT_UID_END (DES_HEARTBEAT_UID_AT + ((DES_HEARTBEAT_UID_AT < 0) ? 1 : 6))
#define HEARTBEAT_MODE_END (DES_HEARTBEAT_MODE_AT + 1)
#define HEARTBEAT_ERROR_END (DES_HEARTBEAT_ERROR_AT + 1)
#define LONGER(a, b) (((a) > (b)) ? (a) : (b))
#define HEARTBEAT_LENGTH \
    LONGER(HEARTBEAT_UID_END, LONGER(HEARTBEAT_MODE_END, HEARTBEAT_ERROR_END))

/* Sends the heartbeat that is due, or the claim; returns false if it is to be tried again. One
 * whose predecessor still waits is left out. */
static bool send_heartbeat(des_node *node)
{
    uint8_t data[MAX_CLASSIC_DATA] = {0u};
    des_frame frame;

    if ((node->busy & BUSY_HEARTBEAT) != 0u) {
        return true;
    }
#if DES_HEARTBEAT_UID_AT >= 0
    copy(&data[DES_HEARTBEAT_UID_AT], node->settings.uid, 6u);
#endif
#if DES_HEARTBEAT_MODE_AT >= 0
    data[DES_HEARTBEAT_MODE_AT] = (uint8_t)node->mode;
#endif
#if DES_HEARTBEAT_ERROR_AT >= 0
    data[DES_HEARTBEAT_ERROR_AT] = node->error;
#endif
    frame.data = data;
    frame.length = HEARTBEAT_LENGTH;
    frame.flags = (uint8_t)(node->stage & DES_FRAME_ONCE);
    frame.id = des_unsolicited_id(node, DES_SRV_HEARTBEAT);
    if (!node->port->send(node->user, DES_SLOT_HEARTBEAT, &frame)) {
        return false;
    }
    node->busy |= BUSY_HEARTBEAT;
    return true;
}

/* Remembers the heartbeat of a working node with this node's UID, which then must not work. */
static void check_uid(des_node *node, const des_frame *frame)
{
#if DES_HEARTBEAT_UID_AT >= 0
    uint32_t at;

    if (((frame->id & (DES_ID_U | DES_ID_R | 0x3FFu)) == (DES_ID_R | DES_SRV_HEARTBEAT))
        && (frame->length >= (DES_HEARTBEAT_UID_AT + 6u))) {
        for (at = 0u; at < 6u; at++) {
            if (frame->data[DES_HEARTBEAT_UID_AT + at] != node->settings.uid[at]) {
                return;
            }
        }
        node->uid_in_use = UID_MEMORY;
    }
#else
    (void)node;
    (void)frame;
#endif
}

/* ---- Requests -------------------------------------------------------------------- */

/* Takes a request: adds it to those of its requester. Returns the requester's entry; NULL if
 * the request is dropped. */
static des_requester *ask(des_node *node, const des_frame *frame, uint32_t request, uint32_t now)
{
    uint32_t peer = des_id_source(frame->id);
    des_requester *requester = (des_requester *)0;
    uint32_t at;

    for (at = 0u; at < DES_REQUESTERS; at++) {
        des_requester *entry = &node->requesters[at];

        if (entry->state == (uint32_t)REQUESTER_FREE) {
            if (requester == (des_requester *)0) {
                requester = entry;
            }
        } else if (entry->peer == peer) {
            requester = entry;
            break;
        } else {
            /* Another requester. */
        }
    }
    if (requester == (des_requester *)0) {
        node->dropped++;
        return requester;
    }
    if (requester->state == (uint32_t)REQUESTER_FREE) {
        requester->pending = 0u;
        requester->current = request;
    }
#if DES_WITH_WRITES || DES_WITH_COMMANDS
    if (((requester->pending & request) == ASK_COMMAND)
        && ((requester->current != request) || (requester->state == (uint32_t)REQUESTER_SENDING))) {
        node->dropped++; /* There is room for one command. */
        return (des_requester *)0;
    }
#endif
    if (requester->current == request) {
        /* A requester that asks again gave up the transfer that is under way: begin again. */
        requester->current = 0u;
        if (requester->state != (uint32_t)REQUESTER_SENDING) {
            requester->state = REQUESTER_READY;
            requester->at = now;
        }
#if DES_WITH_FD
        requester->flags = frame->flags;
#endif
        requester->peer = (uint8_t)peer;
    }
    requester->pending |= (uint16_t)request;
    return requester;
}

/* Takes flow control. */
static void flow(des_node *node, const des_frame *frame, uint32_t now)
{
    const uint8_t *data = frame->data;
    uint32_t peer = des_id_source(frame->id);
    uint32_t at;

    for (at = 0u; at < DES_REQUESTERS; at++) {
        des_requester *requester = &node->requesters[at];

        if ((requester->state == (uint32_t)REQUESTER_FLOW) && (requester->peer == peer)) {
            if (data[0] == 0x30u) {
                requester->block = data[1];
                requester->st_min = data[2];
                if (data[2] > 0x7Fu) {
                    /* 100 to 900 microseconds: 1 ms; a reserved code: 127 ms. */
                    requester->st_min = ((uint8_t)(data[2] - 0xF1u) <= 8u) ? 1u : 0x7Fu;
                }
                requester->state = REQUESTER_READY;
                requester->at = now;
            } else if ((data[0] == 0x31u) && (requester->waits < N_WFT_MAX)) {
                requester->waits++;
                requester->at = now + N_BS;
            } else if (data[0] <= 0x32u) {
                requester->state = REQUESTER_DONE;
            } else {
                /* Reserved: ignored. */
            }
        }
    }
}

/* Takes a frame on the number of DES; is_served: the node's mode is addressed. */
static void receive_des(des_node *node, const des_frame *frame, bool is_served, uint32_t now)
{
    const uint8_t *data = frame->data;
    uint32_t length = frame->length;
    uint32_t request;
    des_requester *requester;

    if ((length >= 3u) && ((data[0] >> 4) == 3u)) {
        flow(node, frame, now);
        return;
    }
    if (!is_served || (length < MIN_REQUEST)) {
        return;
    }
    request = ASK_NAME;
#if DES_WITH_RAW
    if (data[0] == 0x44u) {
        request = ASK_NAME_RAW;
        data--;
        length++;
    } else
#endif
#if DES_WITH_FD
        if (((frame->flags & DES_FRAME_FD) != 0u) && (data[0] == 0u) && (data[1] == 4u)) {
        data++;
        length--;
    } else
#endif
        if (data[0] != 4u) {
        return;
    } else {
        /* A single frame. */
    }
    if (((MIN_REQUEST < 5u) && (length < 5u)) || (data[1] != 0x44u) || (data[2] != 0x45u) || (data[3] != 0x53u)) {
        return;
    }
    if (data[4] == TYPE_SERVICES) {
        request <<= 2;
    } else if (data[4] != TYPE_NAME) {
        if ((frame->id & DES_ID_B) == 0u) {
            requester = ask(node, frame, ASK_COMMAND, now);
            if (requester != (des_requester *)0) {
                requester->service = DES_SRV_DES; /* ERR = 0 */
            }
        }
        return;
    } else {
        /* A name request. */
    }
    (void)ask(node, frame, request, now);
}

#if DES_WITH_DESCRIPTOR
/* A field of the descriptor: where it stands in des_device.info, or in the settings. */
typedef struct {
    uint16_t service;
    uint8_t at;
    uint8_t length;
} field_place;

#define FIELD_COUNT 8u
#define FIRST_SETTING 4u

static const field_place FIELDS[FIELD_COUNT] = {
    {DES_SRV_GID, 0u, 6u},  {DES_SRV_SN, 6u, 4u},   {DES_SRV_FW, 10u, 4u},
    {DES_SRV_CAPS, 14u, 5u}, {DES_SRV_UID, 0u, 6u},  {DES_SRV_ADDR, 6u, 1u},
    {DES_SRV_BSPD, 7u, 1u},  {DES_SRV_AUTOSTART, 8u, 1u}};
#endif

#if DES_WITH_WRITES
static bool is_write(uint32_t service)
{
    return (service == DES_SRV_WRITE_UID) || (service == DES_SRV_WRITE_ADDRESS)
        || (service == DES_SRV_WRITE_BITRATE);
}

/* Writes a setting; returns false if the data are none, or it cannot be stored. */
static bool write_setting(des_node *node, uint32_t service, const uint8_t *data, uint32_t length)
{
    des_settings settings;
    uint32_t expected = 1u;
    bool is_valid = true;

    copy((uint8_t *)&settings, (const uint8_t *)&node->settings, sizeof(settings));
    if (service == DES_SRV_WRITE_UID) {
        expected = 6u;
    } else if (service == DES_SRV_WRITE_ADDRESS) {
        is_valid = data[0] != 0x80u;
    } else {
        is_valid = (data[0] & 0x7Fu) <= 3u;
    }
    if (!is_valid || (length != expected)) {
        return false;
    }
    if (service == DES_SRV_WRITE_UID) {
        copy(settings.uid, data, 6u);
    } else if (service == DES_SRV_WRITE_ADDRESS) {
        settings.address = data[0];
    } else {
        settings.bitrate = data[0];
    }
    if (!node->port->store(node->user, &settings)) {
        return false;
    }
    copy((uint8_t *)&node->settings, (const uint8_t *)&settings, sizeof(settings));
    return true;
}
#endif

#if DES_WITH_COMMANDS
static bool is_mode(uint32_t code)
{
    return is_working_mode(code) || (code == (uint32_t)DES_MODE_INIT)
        || (code == (uint32_t)DES_MODE_ARSLV) || (code == (uint32_t)DES_MODE_CFG)
        || (code == (uint32_t)DES_MODE_BOOT) || (code == (uint32_t)DES_MODE_IDLE);
}

static bool is_command(uint32_t service)
{
    return (service == DES_SRV_MODE) || (service == DES_SRV_IDENTIFY)
        || (service == DES_SRV_REBOOT);
}
#endif

/* Takes a write or a command; returns false if it is refused. */
static bool take_command(des_node *node, uint32_t service, const uint8_t *data, uint32_t length)
{
    bool is_done = false;

#if DES_WITH_WRITES
    if (is_write(service) && (length != 0u)) {
        is_done = write_setting(node, service, data, length);
    }
#endif
#if DES_WITH_COMMANDS
    if (service == DES_SRV_MODE) {
        is_done = (length == 1u) && is_mode(data[0])
            && (!is_working_mode(data[0]) || is_working_mode(permitted(node, data[0])));
    } else {
        is_done = is_done || (service == DES_SRV_IDENTIFY)
            || ((service == DES_SRV_REBOOT) && (length == 0u));
    }
#endif
    (void)node;
    (void)service;
    (void)data;
    (void)length;
    return is_done;
}

/* Takes a targeted request for the descriptor, a write or a command; returns false if its
 * service is none of them. */
static bool serve(des_node *node, const des_frame *frame, uint32_t now)
{
    uint32_t service = des_id_service(frame->id);
    uint32_t length = frame->length;
    bool is_known = false;
    des_requester *requester;
#if DES_WITH_DESCRIPTOR
    uint32_t at;

    for (at = 0u; at < FIELD_COUNT; at++) {
        if (FIELDS[at].service == service) {
            if (length == 0u) {
                (void)ask(node, frame, (uint32_t)ASK_FIELD << at, now);
                return true;
            }
            is_known = true;
        }
    }
#endif
#if DES_WITH_WRITES
    is_known = is_known || is_write(service);
#endif
#if DES_WITH_COMMANDS
    is_known = is_known || is_command(service);
#endif
    if (!is_known) {
        return false;
    }
    requester = ask(node, frame, ASK_COMMAND, now);
    if (requester != (des_requester *)0) {
        requester->service = (uint16_t)service;
        if (take_command(node, service, frame->data, length)) {
            requester->service |= COMMAND_DONE;
#if DES_WITH_COMMANDS
            requester->value = (length == 0u) ? 0u : frame->data[0];
#endif
        }
    }
    return true;
}

/* Does what a command demands, after its response was sent. */
static void act(des_node *node, const des_requester *requester)
{
#if DES_WITH_COMMANDS || (DES_WITH_WRITES && !DES_WRITES_AT_RESTART)
    uint32_t service = requester->service & 0x3FFu;

    if ((requester->service & COMMAND_DONE) == 0u) {
        return;
    }
#if DES_WITH_COMMANDS
    if (service == DES_SRV_MODE) {
        node->wish = requester->value;
    }
    if (service == DES_SRV_IDENTIFY) {
        node->port->event(node->user, DES_EVENT_IDENTIFY, 0u);
    }
    if (service == DES_SRV_REBOOT) {
        node->port->event(node->user, DES_EVENT_REBOOT, 0u);
        node->wish = DES_MODE_INIT;
    }
#endif
#if DES_WITH_WRITES && !DES_WRITES_AT_RESTART
    if (service == DES_SRV_WRITE_ADDRESS) {
        node->wish = DES_MODE_ARSLV;
    }
    if (service == DES_SRV_WRITE_BITRATE) {
        node->wish = DES_MODE_INIT;
    }
#endif
#endif
    (void)node;
    (void)requester;
}

/* ---- Responses --------------------------------------------------------------------- */

/* What the next frame of a response carries. */
typedef struct {
    const uint8_t *bytes;
    uint32_t count;
    uint32_t head; /* Bytes of ISO-TP before them. */
    uint32_t id;   /* ERR and SRV of the identifier. */
} part;

/* Takes the next part of a name or services response, and writes the head of its frame. */
static void take_text(const des_node *node, des_requester *requester, uint8_t *data, part *next)
{
    const des_text *text = &node->device->services;
    uint32_t total = text->size;
    uint32_t sent = requester->sent;
    uint32_t capacity = MAX_CLASSIC_DATA;
    uint32_t head = 1u;
    uint32_t left;

    if ((requester->current & (ASK_NAME | ASK_NAME_RAW)) != 0u) {
        text = &node->device->name;
        total = text->size;
    } else if ((sent == 0u) && (node->mode == (uint32_t)DES_MODE_BOOT)) {
        total = 1u; /* Without firmware it has no services. */
    } else {
        /* Services. */
    }
#if DES_WITH_FD
    if ((requester->flags & DES_FRAME_FD) != 0u) {
        capacity = MAX_DATA;
    }
#endif
    data[0] = (uint8_t)(0x20u | (requester->sequence & 0x0Fu));
#if DES_WITH_RAW
    if ((requester->current & (ASK_NAME_RAW | ASK_SERVICES_RAW)) != 0u) {
        head = 0u;
        if (total > capacity) {
            next->id = DES_SRV_DES; /* ERR = 0: it does not fit. */
            return;
        }
    } else
#endif
        if (sent == 0u) {
        data[0] = (uint8_t)total;
        if (total > MAX_SINGLE) {
            data[1] = (uint8_t)total;
            head = 2u;
            data[0] = (uint8_t)(0x10u | (total >> 8));
#if DES_WITH_FD
            if ((capacity == MAX_DATA) && (total <= MAX_FD_SINGLE)) {
                data[0] = 0u;
            }
#endif
        }
    } else {
        /* A consecutive frame. */
    }
    left = total - sent;
    next->head = head;
    next->bytes = (const uint8_t *)&text->bytes[sent];
    next->count = capacity - head;
    if (left < next->count) {
        next->count = left;
    }
    requester->sent = (uint16_t)(sent + next->count);
    requester->left = (uint16_t)(left - next->count);
}

/* Sends the next frame to a requester, if the transmit buffer takes it. */
static void respond(des_node *node, des_requester *requester)
{
    uint8_t data[MAX_DATA];
    des_frame frame;
    part next = {data, 0u, 0u, DES_ID_ERR | DES_SRV_DES};
    uint32_t length;
    uint16_t sent;

    if (requester->current == 0u) {
        requester->current = requester->pending & (0u - requester->pending);
        requester->sent = 0u;
        requester->left = 0u;
        requester->sequence = 0u;
        requester->block = 1u; /* A first frame needs flow control. */
    }
    sent = requester->sent;
    if ((requester->current & ASK_TEXT) != 0u) {
        take_text(node, requester, data, &next);
    } else {
        if (requester->current == ASK_COMMAND) {
            next.id = requester->service; /* Refused. */
#if DES_WITH_WRITES || DES_WITH_COMMANDS
            next.id = (next.id & 0x3FFu) | ((next.id & COMMAND_DONE) << 9);
#endif
        }
#if DES_WITH_DESCRIPTOR
        else {
            const field_place *field;
            uint32_t at = 0u;

            while ((at < (FIELD_COUNT - 1u)) && (((uint32_t)ASK_FIELD << at) != requester->current)) {
                at++;
            }
            field = &FIELDS[at];
            next.bytes = node->device->info;
            if (at >= FIRST_SETTING) {
                next.bytes = (const uint8_t *)&node->settings;
            }
            next.bytes = &next.bytes[field->at];
            next.count = field->length;
            next.id = DES_ID_ERR | field->service;
        }
#endif
    }
    copy(&data[next.head], next.bytes, next.count);
    length = next.head + next.count;
    frame.flags = 0u;
#if DES_WITH_FD
    if ((requester->flags & DES_FRAME_FD) != 0u) {
        frame.flags = DES_FRAME_FD;
        /* The lengths of a DLC above 8: up to 24 in steps of 4, then 32, 48, 64. */
        while ((length > MAX_CLASSIC_DATA)
               && ((length & ((length <= 24u) ? 3u : ((length <= 32u) ? 7u : 15u))) != 0u)) {
            data[length] = DES_FD_PADDING;
            length++;
        }
    }
#endif
    frame.length = (uint8_t)length;
    frame.data = data;
    frame.id = node->own | DES_ID_R | next.id | ((uint32_t)requester->peer << 10);
    if (node->port->send(node->user, DES_SLOT_RESPONSE, &frame)) {
        node->busy |= BUSY_RESPONSE;
        node->turn = requester;
        requester->state = REQUESTER_SENDING;
        requester->sequence++;
    } else {
        requester->sent = sent; /* Again at the next des_poll. */
    }
}

/* Handles the end of the transmission of a response's frame. */
static void response_sent(des_node *node, bool is_sent, uint32_t now)
{
    des_requester *requester = node->turn;

    if (!is_sent || (requester->left == 0u) || (requester->current == 0u)) {
        if (is_sent && (requester->current == ASK_COMMAND)) {
            act(node, requester);
        }
        requester->state = REQUESTER_DONE;
    } else {
        uint32_t separation = requester->st_min * UINT32_C(1000);

        requester->state = REQUESTER_READY;
        if (requester->block != 0u) {
            requester->block--;
            if (requester->block == 0u) {
                requester->state = REQUESTER_FLOW;
                requester->waits = 0u;
                separation = N_BS;
            }
        }
        requester->at = now + separation;
    }
}

/* Enters the configured mode, at the address that was claimed. */
static void run(des_node *node, uint32_t now)
{
    node->stage = STAGE_RUN;
    node->until = now + HR_TIME;
    if ((node->settings.autostart != 0u) && (node->wish == (uint32_t)DES_MODE_CFG)) {
        node->wish = DES_MODE_WORK;
    }
}

/* Learns what became of the frames in the transmit buffers. */
static void collect(des_node *node, uint32_t now)
{
    uint8_t slot;

    for (slot = 0u; slot < 2u; slot++) {
        des_tx result = DES_TX_PENDING;

        if ((node->busy & (UINT32_C(1) << slot)) != 0u) {
            result = node->port->sent(node->user, slot);
        }
        if (result == DES_TX_PENDING) {
            continue;
        }
        node->busy ^= UINT32_C(1) << slot;
        if (slot == DES_SLOT_RESPONSE) {
            response_sent(node, result == DES_TX_SENT, now);
        } else if (node->stage != (uint32_t)STAGE_CLAIM) {
            /* A heartbeat. */
        } else if (result == DES_TX_SENT) {
            run(node, now);
        } else {
            /* Chooses again. The controller stays active: two nodes on an empty bus need each
             * other's acknowledgement. */
            node->stage = STAGE_LISTEN;
            node->until = now;
        }
    }
}

/* ---- Entry points -------------------------------------------------------------------- */

void des_init(des_node *node, const des_port *port, const des_device *device, void *user)
{
    node->port = port;
    node->device = device;
    node->user = user;
    node->turn = node->requesters;
    node->limit = DES_MODE_WORK;
    node->error = 0u;
    node->uid_in_use = 0u;
    node->dropped = 0u;
    node->busy = 0u;
    node->random = 0u;
    node->own = DES_ID_U;
    node->mode = DES_MODE_INIT;
    node->wish = DES_MODE_INIT;
    node->stage = STAGE_LISTEN;
    port->load(user, &node->settings);
}

bool des_receive(des_node *node, const des_frame *frame, uint32_t now)
{
    uint32_t id = frame->id;
    uint32_t service = des_id_service(id);
    bool is_working;

    collect(node, now);
    if (node->stage == (uint32_t)STAGE_INIT) {
        node->wish = DES_MODE_ARSLV; /* A frame: the bit rate is right. */
    }
    if (!des_id_is_conforming(id)) {
        return false;
    }
    check_uid(node, frame);
    is_working = des_is_working(node);
    /* Another user of its address moves a node, but not in IDLE (CAN platform 3.2.4.5), nor a
     * claim a working node (3.2.4.4). */
    if ((node->stage >= (uint32_t)STAGE_WAIT) && (((id ^ node->own) & ADDRESS_MASK) == 0u)
        && (node->mode != (uint32_t)DES_MODE_IDLE) && ((id & ~node->own & DES_ID_U) == 0u)) {
        node->wish = WISH_MOVE;
        return false;
    }
    if (node->stage != (uint32_t)STAGE_RUN) {
        note_address(node, des_id_source(id));
        if ((id & DES_ID_B) == 0u) {
            note_address(node, des_id_destination(id));
        }
        return false;
    }
    if (((id & DES_ID_B) == 0u) && ((((id << 7) ^ node->own) & ADDRESS_MASK) != 0u)) {
        return false;
    }
    if ((id & DES_ID_R) != 0u) {
        return true;
    }
    /* Requests to nodes in its mode; in IDLE that to change the mode. */
    is_working = (((id & DES_ID_D) == 0u) == is_working)
        && ((node->mode != (uint32_t)DES_MODE_IDLE) || (service == DES_SRV_MODE));
    if (service == DES_SRV_DES) {
        receive_des(node, frame, is_working, now);
        return false;
    }
    if (!is_working) {
        return false;
    }
    return ((id & DES_ID_B) != 0u) || !serve(node, frame, now);
}

/* Sends the responses that are due; returns true if there is nothing to answer. */
static bool poll_requesters(des_node *node, uint32_t now)
{
    des_requester *requester = node->turn;
    uint32_t states = REQUESTER_FREE;
    uint32_t at;

    for (at = 0u; at < DES_REQUESTERS; at++) {
        requester++;
        if (requester == &node->requesters[DES_REQUESTERS]) {
            requester = node->requesters;
        }
        if ((requester->state == (uint32_t)REQUESTER_DONE)
            || ((requester->state == (uint32_t)REQUESTER_FLOW) && is_due(requester->at, now))) {
            /* Answered, or given up (overflow, N_Bs): turn to its next request. */
            requester->pending &= (uint16_t)~requester->current;
            requester->current = 0u;
            requester->at = now;
            requester->state = (requester->pending == 0u) ? (uint32_t)REQUESTER_FREE : (uint32_t)REQUESTER_READY;
        }
        if ((requester->state == (uint32_t)REQUESTER_READY) && is_due(requester->at, now)
            && ((node->busy & BUSY_RESPONSE) == 0u)) {
            respond(node, requester);
        }
        states |= requester->state;
    }
    return states == (uint32_t)REQUESTER_FREE;
}

/* Sends the heartbeat that is due, or the claim. */
static void beat(des_node *node, uint32_t now)
{
    set_bus(node, 0u); /* Until the first claim it was silent. */
    if (send_heartbeat(node)) {
        if (node->stage == (uint32_t)STAGE_WAIT) {
            node->stage = STAGE_CLAIM;
        }
        if (node->uid_in_use > 0u) {
            node->uid_in_use--;
        }
        node->until += HR_TIME;
        if (is_due(node->until, now)) {
            node->until = now + HR_TIME;
        }
    }
}

uint32_t des_poll(des_node *node, uint32_t now)
{
    uint32_t errors;

    collect(node, now);
    errors = node->port->errors(node->user);
    if (node->stage != (uint32_t)STAGE_INIT) {
        if ((errors & (DES_ERROR_SEEN - 1u)) >= DES_MAX_ERRORS) {
            node->wish = DES_MODE_INIT;
        }
    } else if (((errors & DES_ERROR_SEEN) != 0u) && (node->wish != (uint32_t)DES_MODE_ARSLV)) {
        node->wish = DES_MODE_INIT;
    } else {
        /* Listens on, or has received a frame. */
    }
    change_mode(node, now);
    if (is_due(node->until, now)) {
        if (node->stage <= (uint32_t)STAGE_LISTEN) {
            /* INIT: no node is there yet. ARSLV: no address is free. */
            if ((node->stage == (uint32_t)STAGE_INIT) || !choose(node, now)) {
                node->wish = DES_MODE_ARSLV;
            }
        } else if (node->stage != (uint32_t)STAGE_CLAIM) {
            beat(node, now);
        } else {
            /* The claim is being sent. */
        }
    }
    if ((node->stage == (uint32_t)STAGE_RUN) && poll_requesters(node, now)
        && ((node->busy & BUSY_ANY) == 0u) && !is_due(node->until, now)) {
        return node->until - now;
    }
    return DES_POLL_US;
}
