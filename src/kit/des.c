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

/* SENDING and LAST: a frame of the response, or its last one, is in the transmit buffer. */
enum {
    REQUESTER_FREE,
    REQUESTER_READY,
    REQUESTER_FLOW,
    REQUESTER_DONE,
    REQUESTER_SENDING,
    REQUESTER_LAST
};

/* des_node.wish: ARSLV, because another node uses the address. */
#define WISH_MOVE (0x100u | DES_MODE_ARSLV)

/* des_node.busy: one bit for each transmit buffer; and that the controller is silent. */
#define BUSY_HEARTBEAT (1u << DES_SLOT_HEARTBEAT)
#define BUSY_RESPONSE (1u << DES_SLOT_RESPONSE)
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

/* In des_requester.command and part.service: the request is refused, ERR of the response is 0. */
#define REFUSED DES_ID_ERR

/* Bytes of the shortest frame with a request. */
#if DES_WITH_RAW
#define MIN_REQUEST 4u
#else
#define MIN_REQUEST 5u
#endif

/* "DES", with which a request begins. */
#define DES_LETTERS UINT32_C(0x444553)

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
    uint32_t bits = node->port->entropy(node->user);

    /* A linear congruential generator: its high bits are the random ones. */
    node->random = (node->random + bits + 1u) * UINT32_C(0x9E3779B1);
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
    if (mode == (uint32_t)DES_MODE_CFG) {
        return (node->limit == (uint32_t)DES_MODE_BOOT) ? (uint32_t)DES_MODE_BOOT : mode;
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

/* Returns true if the address in SRC of an identifier is in use. */
static bool is_in_use(const des_node *node, uint32_t id)
{
    return ((node->in_use[(id >> 22) & 3u] >> ((id >> 17) & 31u)) & 1u) != 0u;
}

/* Remembers that the address in SRC of an identifier is in use. */
static void note_source(des_node *node, uint32_t id)
{
    node->in_use[(id >> 22) & 3u] |= UINT32_C(1) << ((id >> 17) & 31u);
}

/* Begins to listen for 1.5 * BUS_CFG_HR_TIME: in INIT for any frame, in ARSLV for addresses in
 * use. */
static void listen(des_node *node, uint32_t mode, uint32_t now)
{
    uint32_t rate = node->settings.bitrate;
    uint32_t at;

    if (mode == (uint32_t)DES_MODE_INIT) {
        if (node->stage == (uint32_t)STAGE_INIT) {
            rate = node->rate + (rate >> 7); /* Bus errors: another one, unless it is fixed. */
        }
        node->rate = (uint8_t)(rate & 3u);
        node->busy = 0u; /* The controller is configured anew in any case. */
    }
    node->stage = (mode == (uint32_t)DES_MODE_INIT) ? STAGE_INIT : STAGE_LISTEN;
    node->until = now + LISTEN_TIME;
    for (at = 0u; at < 4u; at++) {
        node->in_use[at] = 0u;
    }
    if (node->wish > 0xFFu) {
        note_source(node, node->own);
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
    uint32_t mode = permitted(node, node->wish & 0xFFu);

    if ((mode == (uint32_t)DES_MODE_INIT) || (mode == (uint32_t)DES_MODE_ARSLV)) {
        listen(node, mode, now);
    } else if (node->stage == (uint32_t)STAGE_RUN) {
        node->wish = mode;
    } else {
        return;
    }
    if (node->mode != mode) {
        node->mode = mode;
        node->own = (node->own & ADDRESS_MASK) | (is_working_mode(mode) ? 0u : DES_ID_U);
        if (mode == (uint32_t)DES_MODE_IDLE) {
            node->until = now; /* The others learn of it before it sleeps. */
        }
        node->port->event(node->user, DES_EVENT_MODE, (uint8_t)mode);
    }
}

/* ARSLV: chooses an address, to be claimed after a random part of BUS_CFG_HR_TIME. Returns false
 * if it finds none that is free. */
static bool choose(des_node *node, uint32_t now)
{
    uint32_t setting = node->settings.address;
    uint32_t choice = (setting & 0x7Fu) << 17; /* At the place of SRC. */
    uint32_t tries;

    for (tries = 0u; tries < 128u; tries++) {
        if ((choice != 0u) && !is_in_use(node, choice)) {
            node->own = DES_ID_U | choice;
            node->stage = STAGE_WAIT;
            node->until = now + (((des_random(node) >> 16) * (HR_TIME >> 10)) >> 6);
            return true;
        }
        if ((setting - 1u) < 0x7Fu) {
            break; /* A fixed address. */
        }
        choice = (des_random(node) >> 25) << 17;
    }
    return false;
}

/* ---- Transmission ---------------------------------------------------------------- */

/* Puts a frame into a transmit buffer; returns false if that is not possible now. */
static bool transmit(des_node *node, uint8_t slot, const des_frame *frame)
{
    if (!node->port->send(node->user, slot, frame)) {
        return false;
    }
    node->busy |= UINT32_C(1) << slot;
    return true;
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
    return transmit(node, DES_SLOT_HEARTBEAT, &frame);
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

/* Returns the entry of a requester, else a free one; NULL if others have all. */
static des_requester *find_requester(des_node *node, uint32_t peer)
{
    des_requester *found = (des_requester *)0;
    uint32_t at;

    for (at = DES_REQUESTERS; at > 0u; at--) {
        des_requester *entry = &node->requesters[at - 1u];

        if (entry->state == (uint32_t)REQUESTER_FREE) {
            found = entry;
        } else if (entry->peer == peer) {
            return entry;
        } else {
            /* Another requester. */
        }
    }
    return found;
}

/* Takes flow control. */
static void flow(des_requester *requester, const uint8_t *data, uint32_t now)
{
    uint32_t status = data[0] & 0x0Fu;
    uint32_t st_min = data[2];

    if ((status == 1u) && (requester->block < N_WFT_MAX)) {
        requester->block++;
        requester->at = now + N_BS;
    } else if (status <= 2u) {
        requester->at = now;
        requester->state = REQUESTER_DONE; /* Overflow, or too many with WAIT. */
        if (status == 0u) {
            requester->state = REQUESTER_READY;
            requester->block = data[1];
            if (st_min > 0x7Fu) {
                /* 100 to 900 microseconds: 1 ms; a reserved code: 127 ms. */
                st_min = ((st_min - 0xF1u) <= 8u) ? 1u : 0x7Fu;
            }
            requester->st_min = (uint8_t)st_min;
        }
    } else {
        /* Reserved: ignored. */
    }
}

/* Returns what a frame on the number of DES requests; 0: it is no request. */
static uint32_t des_request(const des_frame *frame)
{
    const uint8_t *data = frame->data;
    uint32_t request = ASK_NAME;
    uint32_t at = 1u; /* Of the request in the frame. */

    if (frame->length < MIN_REQUEST) {
        return 0u;
    }
#if DES_WITH_RAW
    if (data[0] == 0x44u) {
        request = ASK_NAME_RAW;
        at = 0u;
    } else
#endif
#if DES_WITH_FD
        if (((frame->flags & DES_FRAME_FD) != 0u) && (data[0] == 0u) && (data[1] == 4u)) {
        at = 2u;
    } else
#endif
        if (data[0] != 4u) {
        return 0u;
    } else {
        /* A single frame. */
    }
    if (frame->length < (at + 4u)) {
        return 0u;
    }
    data = &data[at];
    if ((((uint32_t)data[0] << 16) | ((uint32_t)data[1] << 8) | data[2]) != DES_LETTERS) {
        return 0u;
    }
    if (data[3] == TYPE_NAME) {
        return request;
    }
    if (data[3] == TYPE_SERVICES) {
        return request << 2;
    }
    return ((frame->id & DES_ID_B) == 0u) ? ASK_COMMAND : 0u; /* To be refused. */
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
static bool take_command(des_node *node, des_requester *requester, const uint8_t *data,
                         uint32_t length)
{
    uint32_t service = requester->command;
    bool is_done = false;

#if DES_WITH_WRITES
    if (is_write(service) && (length != 0u)) {
        is_done = write_setting(node, service, data, length);
    }
#endif
#if DES_WITH_COMMANDS
    if (service == DES_SRV_MODE) {
        if (length == 1u) {
            requester->value = data[0];
            is_done = is_mode(data[0])
                && (is_working_mode(data[0]) == is_working_mode(permitted(node, data[0])));
        }
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

/* Returns what a targeted request of another service than DES requests; 0: nothing of the kit. */
static uint32_t service_request(uint32_t service, uint32_t length)
{
    uint32_t request = 0u;
#if DES_WITH_DESCRIPTOR
    uint32_t at;

    for (at = 0u; at < FIELD_COUNT; at++) {
        if (FIELDS[at].service == service) {
            if (length == 0u) {
                return (uint32_t)ASK_FIELD << at;
            }
            request = ASK_COMMAND;
        }
    }
#endif
#if DES_WITH_WRITES
    if (is_write(service)) {
        request = ASK_COMMAND;
    }
#endif
#if DES_WITH_COMMANDS
    if (is_command(service)) {
        request = ASK_COMMAND;
    }
#endif
    (void)service;
    (void)length;
    return request;
}

/* Takes a request: adds it to those of its requester. */
static void ask(des_node *node, des_requester *requester, const des_frame *frame, uint32_t request,
                uint32_t now)
{
    if (requester == (des_requester *)0) {
        node->dropped++;
        return;
    }
    if (requester->state == (uint32_t)REQUESTER_FREE) {
        requester->pending = 0u;
        requester->current = request;
    }
#if DES_WITH_WRITES || DES_WITH_COMMANDS
    if (((requester->pending & request) == ASK_COMMAND)
        && ((requester->current != request)
            || (requester->state >= (uint32_t)REQUESTER_SENDING))) {
        node->dropped++; /* There is room for one command. */
        return;
    }
#endif
    if (requester->current == request) {
        /* A requester that asks again gave up the transfer that is under way: begin again. */
        requester->current = 0u;
        if (requester->state < (uint32_t)REQUESTER_SENDING) {
            requester->state = REQUESTER_READY;
            requester->at = now;
        }
#if DES_WITH_FD
        requester->flags = frame->flags;
#endif
        requester->peer = des_id_source(frame->id);
    }
    requester->pending |= request;
    if (request == ASK_COMMAND) {
        requester->command = des_id_service(frame->id);
        if (!take_command(node, requester, frame->data, frame->length)) {
            requester->command |= REFUSED;
        }
    }
}

/* Does what a command demands, after its response was sent. */
static void act(des_node *node, const des_requester *requester)
{
#if DES_WITH_COMMANDS || (DES_WITH_WRITES && !DES_WRITES_AT_RESTART)
    uint32_t service = requester->command; /* With REFUSED it is none of these. */

#if DES_WITH_COMMANDS
    if (service == DES_SRV_MODE) {
        node->wish = requester->value;
    }
    if ((service == DES_SRV_IDENTIFY) || (service == DES_SRV_REBOOT)) {
        des_event event = DES_EVENT_IDENTIFY;

        if (service == DES_SRV_REBOOT) {
            event = DES_EVENT_REBOOT;
            node->wish = DES_MODE_INIT;
        }
        node->port->event(node->user, event, 0u);
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
    uint32_t left;    /* Bytes of the response from there on. */
    uint32_t head;    /* Bytes of ISO-TP before them. */
    uint32_t service; /* SRV of the identifier; with REFUSED: ERR = 0. */
} part;

/* Returns what the next frame of a name or services response carries, up to `capacity` bytes, and
 * writes the head of the frame. */
static void take_text(const des_node *node, const des_requester *requester, uint32_t capacity,
                      uint8_t *data, part *next)
{
    const des_text *text = &node->device->services;
    uint32_t sent = requester->sent;
    uint32_t total;

    if ((requester->current & (ASK_NAME | ASK_NAME_RAW)) != 0u) {
        text = &node->device->name;
    }
    total = text->size;
    if ((sent == 0u) && (node->mode == (uint32_t)DES_MODE_BOOT)
        && ((requester->current & (ASK_SERVICES | ASK_SERVICES_RAW)) != 0u)) {
        total = 1u; /* Without firmware it has no services. */
    }
    next->bytes = (const uint8_t *)&text->bytes[sent];
    next->left = total - sent;
#if DES_WITH_RAW
    if ((requester->current & (ASK_NAME_RAW | ASK_SERVICES_RAW)) != 0u) {
        if (total > capacity) {
            next->left = 0u;
            next->service = DES_SRV_DES | REFUSED; /* It does not fit. */
        }
        return;
    }
#endif
    next->head = 1u;
    if (sent != 0u) {
        data[0] = (uint8_t)(0x20u | (requester->sequence & 0x0Fu));
    } else if (total <= MAX_SINGLE) {
        data[0] = (uint8_t)total;
    } else {
        next->head = 2u;
        data[0] = (uint8_t)(0x10u | (total >> 8));
        data[1] = (uint8_t)total;
#if DES_WITH_FD
        if ((capacity == MAX_DATA) && (total <= MAX_FD_SINGLE)) {
            data[0] = 0u;
        }
#endif
    }
    (void)capacity;
}

#if DES_WITH_DESCRIPTOR
/* Returns what the response with a field of the descriptor carries. */
static void take_field(const des_node *node, const des_requester *requester, part *next)
{
    const field_place *field = FIELDS;
    uint32_t bit;

    /* ASK_FIELD is the first field; each bit above it, up to FIELD_COUNT - 1, is the next one. */
    for (bit = requester->current; bit > ASK_FIELD; bit >>= 1) {
        field++;
    }
    next->bytes = node->device->info;
    if (requester->current >= (ASK_FIELD << FIRST_SETTING)) {
        next->bytes = (const uint8_t *)&node->settings;
    }
    next->bytes = &next->bytes[field->at];
    next->left = field->length;
    next->service = field->service;
}
#endif

/* Sends the next frame to a requester, if the transmit buffer takes it. */
static void respond(des_node *node, des_requester *requester)
{
    uint8_t data[MAX_DATA];
    des_frame frame;
    part next = {data, 0u, 0u, DES_SRV_DES};
    uint32_t capacity = MAX_CLASSIC_DATA;
    uint32_t count;
    uint32_t length;

    if (requester->current == 0u) {
        requester->current = requester->pending & (0u - requester->pending);
        requester->sent = 0u;
        requester->sequence = 0u;
        requester->block = 1u; /* A first frame needs flow control. */
    }
    frame.flags = 0u;
#if DES_WITH_FD
    frame.flags = requester->flags & DES_FRAME_FD;
    if (frame.flags != 0u) {
        capacity = MAX_DATA;
    }
#endif
    if ((requester->current & ASK_TEXT) != 0u) {
        take_text(node, requester, capacity, data, &next);
    } else if (requester->current == ASK_COMMAND) {
        next.service = requester->command;
    } else {
        /* A field of the descriptor. */
#if DES_WITH_DESCRIPTOR
        take_field(node, requester, &next);
#endif
    }
    count = capacity - next.head;
    if (count > next.left) {
        count = next.left;
    }
    copy(&data[next.head], next.bytes, count);
    length = next.head + count;
#if DES_WITH_FD
    /* The lengths of a DLC above 8: up to 24 in steps of 4, then 32, 48, 64. */
    while ((length > MAX_CLASSIC_DATA)
           && ((length & ((length <= 24u) ? 3u : ((length <= 32u) ? 7u : 15u))) != 0u)) {
        data[length] = DES_FD_PADDING;
        length++;
    }
#endif
    frame.length = (uint8_t)length;
    frame.data = data;
    /* REFUSED clears ERR. */
    frame.id = (node->own | DES_ID_R | DES_ID_ERR | ((uint32_t)requester->peer << 10)) ^ next.service;
    if (transmit(node, DES_SLOT_RESPONSE, &frame)) {
        node->turn = requester;
        requester->state = (count == next.left) ? REQUESTER_LAST : REQUESTER_SENDING;
        requester->sent = (uint16_t)(requester->sent + count);
        requester->sequence++;
    }
}

/* Handles the end of the transmission of a response's frame. */
static void response_sent(des_node *node, bool is_sent, uint32_t now)
{
    des_requester *requester = node->turn;
    uint32_t wait = 0u; /* Milliseconds. */

    if (!is_sent || (requester->state == (uint32_t)REQUESTER_LAST)
        || (requester->current == 0u)) {
        requester->state = REQUESTER_DONE;
        if (is_sent && (requester->current == ASK_COMMAND)) {
            act(node, requester);
        }
    } else {
        requester->state = REQUESTER_READY;
        wait = requester->st_min;
        if (requester->block != 0u) {
            requester->block--;
            if (requester->block == 0u) {
                requester->state = REQUESTER_FLOW;
                wait = N_BS / 1000u;
            }
        }
    }
    requester->at = now + (wait * 1000u);
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

/* Handles the end of the transmission of a heartbeat or claim. */
static void heartbeat_sent(des_node *node, bool is_sent, uint32_t now)
{
    if (node->stage != (uint32_t)STAGE_CLAIM) {
        /* A heartbeat. */
    } else if (is_sent) {
        run(node, now);
    } else {
        /* Chooses again. The controller stays active: two nodes on an empty bus need each
         * other's acknowledgement. */
        node->stage = STAGE_LISTEN;
        node->until = now;
    }
}

/* Learns what became of the frames in the transmit buffers. */
static void collect(des_node *node, uint32_t now)
{
    des_tx result;

    if ((node->busy & BUSY_HEARTBEAT) != 0u) {
        result = node->port->sent(node->user, DES_SLOT_HEARTBEAT);
        if (result != DES_TX_PENDING) {
            node->busy ^= BUSY_HEARTBEAT;
            heartbeat_sent(node, result == DES_TX_SENT, now);
        }
    }
    if ((node->busy & BUSY_RESPONSE) != 0u) {
        result = node->port->sent(node->user, DES_SLOT_RESPONSE);
        if (result != DES_TX_PENDING) {
            node->busy ^= BUSY_RESPONSE;
            response_sent(node, result == DES_TX_SENT, now);
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
    uint32_t id;
    uint32_t differing;
    uint32_t service;
    uint32_t request = 0u;
    des_requester *requester;

    collect(node, now);
    if (node->stage == (uint32_t)STAGE_INIT) {
        node->wish = DES_MODE_ARSLV; /* A frame: the bit rate is right. */
    }
    id = frame->id;
    if (!des_id_is_conforming(id)) {
        return false;
    }
    check_uid(node, frame);
    differing = id ^ node->own;
    /* Another user of its address moves a node, but not in IDLE (CAN platform 3.2.4.5), nor does
     * a claim, with U = 1, move a working node, whose U is 0 (3.2.4.4). */
    if ((node->stage >= (uint32_t)STAGE_WAIT) && ((differing & ADDRESS_MASK) == 0u)
        && (node->mode != (uint32_t)DES_MODE_IDLE) && ((id & differing & DES_ID_U) == 0u)) {
        node->wish = WISH_MOVE;
        return false;
    }
    if (node->stage != (uint32_t)STAGE_RUN) {
        note_source(node, id);
        if ((id & DES_ID_B) == 0u) {
            note_source(node, id << 7); /* DST, at the place of SRC. */
        }
        return false;
    }
    if (((id & DES_ID_B) == 0u) && ((((id << 7) ^ node->own) & ADDRESS_MASK) != 0u)) {
        return false;
    }
    if ((id & DES_ID_R) != 0u) {
        return true;
    }
    service = des_id_service(id);
    requester = find_requester(node, des_id_source(id));
    if ((service == DES_SRV_DES) && (frame->length >= 3u) && ((frame->data[0] >> 4) == 3u)) {
        if ((requester != (des_requester *)0) && (requester->state == (uint32_t)REQUESTER_FLOW)) {
            flow(requester, frame->data, now);
        }
        return false;
    }
    /* Requests to nodes in its mode, where D is its U; in IDLE that to change the mode. */
    if (((((id << 1) ^ node->own) & DES_ID_U) != 0u)
        || ((node->mode == (uint32_t)DES_MODE_IDLE) && (service != DES_SRV_MODE))) {
        return false;
    }
    if (service == DES_SRV_DES) {
        request = des_request(frame);
        if (request == 0u) {
            return false; /* Malformed, or a broadcast of a reserved type. */
        }
    } else {
        if ((id & DES_ID_B) == 0u) {
            request = service_request(service, frame->length);
        }
        if (request == 0u) {
            return true; /* Of the application. */
        }
    }
    ask(node, requester, frame, request, now);
    return false;
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
        if (is_due(requester->at, now)) {
            if ((requester->state == (uint32_t)REQUESTER_DONE)
                || (requester->state == (uint32_t)REQUESTER_FLOW)) {
                /* Answered, or given up (overflow, N_Bs): turn to its next request. */
                requester->pending &= ~requester->current;
                requester->current = 0u;
                requester->state = (requester->pending == 0u) ? REQUESTER_FREE : REQUESTER_READY;
            }
            if ((requester->state == (uint32_t)REQUESTER_READY)
                && ((node->busy & BUSY_RESPONSE) == 0u)) {
                respond(node, requester);
            }
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
        && (node->busy == 0u) && !is_due(node->until, now)) {
        return node->until - now;
    }
    return DES_POLL_US;
}
