/*
 * des.h - DES responder and node of the CAN platform, for firmware.
 *
 * DES, the devices enumeration service, lets a tool such as descan request the
 * name and the services of each device on a CAN bus. This kit is the device's
 * side: it takes an address, sends the heartbeat, answers DES requests, reads
 * and writes of the descriptor and commands. Copy des.h and des.c into the
 * firmware, and a des_config.h beside them:
 *
 *     descan kit --profile line7.toml --name PUMP --services FLOW=1.0 --write DIR
 *
 * It allocates nothing, needs no library, has no threads, timers or globals,
 * and is freestanding C99. It does not know the CAN controller, flash memory or
 * the clock: the firmware passes them as functions (des_port) and facts.
 *
 * Use:
 *
 *     static des_node node;
 *
 *     des_init(&node, &port, &device, NULL);
 *     for (;;) {
 *         while (can_receive(&frame)) {
 *             if (des_receive(&node, &frame, now_us())) {
 *                 application_receive(&frame);
 *             }
 *         }
 *         (void)des_poll(&node, now_us());
 *     }
 *
 * Context: all functions of one node are called from one context, usually the
 * main loop, with frames from a queue that an interrupt fills. The kit calls the
 * functions of des_port from des_init, des_receive, des_poll and des_random, never
 * from elsewhere; they must not call the kit. Several nodes (two CAN controllers)
 * are independent of each other.
 *
 * Time: microseconds, an unsigned 32-bit number that wraps from 0xFFFFFFFF to 0.
 * Each call has the present time. At most 30 minutes may pass between two calls.
 *
 * SPDX-License-Identifier: MIT
 */
#ifndef DES_H
#define DES_H

#include <stdbool.h>
#include <stdint.h>

#include "des_config.h"

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Configuration: each value may be set in des_config.h ---------------- */

/* Compile-time switches: 1 or 0. */
#ifndef DES_WITH_FD /* CAN FD: requests and responses of up to 64 bytes. */
#define DES_WITH_FD 1
#endif
#ifndef DES_WITH_RAW /* Raw framing beside ISO-TP. */
#define DES_WITH_RAW 1
#endif
#ifndef DES_WITH_DESCRIPTOR /* Reads of the descriptor. */
#define DES_WITH_DESCRIPTOR 1
#endif
#ifndef DES_WITH_WRITES /* Writes of UID, address and bit rate. */
#define DES_WITH_WRITES 1
#endif
#ifndef DES_WITH_COMMANDS /* Mode, reboot and identify. */
#define DES_WITH_COMMANDS 1
#endif

/* Requesters that are served at the same time, 1 to 100; 28 bytes each. The
 * requests of further ones are dropped, see des_node.dropped. */
#ifndef DES_REQUESTERS
#define DES_REQUESTERS 3
#endif

/* Service numbers, 0 to 0x3FF. DES_NONE: the device does not serve it. */
#define DES_NONE 0xFFFFu
#ifndef DES_SRV_HEARTBEAT
#define DES_SRV_HEARTBEAT 0x001u
#endif
#ifndef DES_SRV_DES
#define DES_SRV_DES 0x002u
#endif
#ifndef DES_SRV_GID
#define DES_SRV_GID 0x010u
#endif
#ifndef DES_SRV_UID
#define DES_SRV_UID 0x011u
#endif
#ifndef DES_SRV_SN
#define DES_SRV_SN 0x012u
#endif
#ifndef DES_SRV_FW
#define DES_SRV_FW 0x013u
#endif
#ifndef DES_SRV_CAPS
#define DES_SRV_CAPS 0x014u
#endif
#ifndef DES_SRV_BSPD
#define DES_SRV_BSPD 0x015u
#endif
#ifndef DES_SRV_ADDR
#define DES_SRV_ADDR 0x016u
#endif
#ifndef DES_SRV_AUTOSTART
#define DES_SRV_AUTOSTART 0x017u
#endif
#ifndef DES_SRV_IDENTIFY
#define DES_SRV_IDENTIFY DES_NONE
#endif
#ifndef DES_SRV_MODE
#define DES_SRV_MODE DES_NONE
#endif
#ifndef DES_SRV_REBOOT
#define DES_SRV_REBOOT DES_NONE
#endif
#ifndef DES_SRV_WRITE_UID
#define DES_SRV_WRITE_UID DES_NONE
#endif
#ifndef DES_SRV_WRITE_ADDRESS
#define DES_SRV_WRITE_ADDRESS DES_NONE
#endif
#ifndef DES_SRV_WRITE_BITRATE
#define DES_SRV_WRITE_BITRATE DES_NONE
#endif

/* 1: a written address or bit rate acts at the next start; 0: at once. */
#ifndef DES_WRITES_AT_RESTART
#define DES_WRITES_AT_RESTART 0
#endif

/* Heartbeat: BUS_CFG_HR_TIME in milliseconds, 10 to 60000, and the offsets of its
 * fields, in bytes; -1: it does not carry the field. */
#ifndef DES_HEARTBEAT_MS
#define DES_HEARTBEAT_MS 1000u
#endif
#ifndef DES_HEARTBEAT_UID_AT
#define DES_HEARTBEAT_UID_AT 0
#endif
#ifndef DES_HEARTBEAT_MODE_AT
#define DES_HEARTBEAT_MODE_AT 6
#endif
#ifndef DES_HEARTBEAT_ERROR_AT
#define DES_HEARTBEAT_ERROR_AT 7
#endif

/* Codes of the modes on the bus; all different. */
#ifndef DES_CODE_INIT
#define DES_CODE_INIT 0
#endif
#ifndef DES_CODE_ARSLV
#define DES_CODE_ARSLV 1
#endif
#ifndef DES_CODE_CFG
#define DES_CODE_CFG 2
#endif
#ifndef DES_CODE_BOOT
#define DES_CODE_BOOT 3
#endif
#ifndef DES_CODE_WORK
#define DES_CODE_WORK 4
#endif
#ifndef DES_CODE_UFUNC
#define DES_CODE_UFUNC 5
#endif
#ifndef DES_CODE_IDLE
#define DES_CODE_IDLE 6
#endif

/* 1: numbers of several bytes have the highest byte first. */
#ifndef DES_BIG_ENDIAN
#define DES_BIG_ENDIAN 0
#endif
/* Byte that fills FD frames up to the next length that a DLC can express. */
#ifndef DES_FD_PADDING
#define DES_FD_PADDING 0xCCu
#endif
/* BUS_CFG_TXERR_MAX: error counter at which the node leaves the bus and begins
 * again in INIT. */
#ifndef DES_MAX_ERRORS
#define DES_MAX_ERRORS 128u
#endif
/* Microseconds until the next des_poll while the kit waits for the controller. */
#ifndef DES_POLL_US
#define DES_POLL_US 1000u
#endif

#if (DES_REQUESTERS < 1) || (DES_REQUESTERS > 100)
#error "DES_REQUESTERS is 1 to 100"
#endif
#if (DES_HEARTBEAT_MS < 10) || (DES_HEARTBEAT_MS > 60000)
#error "DES_HEARTBEAT_MS is 10 to 60000"
#endif
#if (DES_HEARTBEAT_UID_AT > 2) || (DES_HEARTBEAT_MODE_AT > 7) || (DES_HEARTBEAT_ERROR_AT > 7)
#error "a field of the heartbeat ends behind its eighth byte"
#endif

/* ---- Frames --------------------------------------------------------------- */

/* Bits of des_frame.flags. */
#define DES_FRAME_FD 0x01u   /* CAN FD frame; whether with BRS is the firmware's choice. */
#define DES_FRAME_ONCE 0x02u /* Send once, without repetition after an error or a lost
                              * arbitration: bxCAN NART, a controller's "single shot". */

/* An extended (29-bit) data frame. Frames with 11 bits and remote frames do not
 * belong to the platform: do not pass them. */
typedef struct {
    uint32_t id;         /* Identifier, 29 bits. */
    const uint8_t *data; /* Valid during the call only. */
    uint8_t length;      /* Bytes of data, 0 to 8; FD: up to 64, a length that a DLC has. */
    uint8_t flags;       /* DES_FRAME_*. */
} des_frame;

/* ---- Settings, device, controller ----------------------------------------- */

/* Configuration that the device keeps without power. */
typedef struct {
    uint8_t uid[6];    /* DEV_CFG_UID; all 00 or all FF: blank. */
    uint8_t address;   /* DEV_CFG_ADDR: 0 none, 1 to 127 fixed, with bit 7 preferred. */
    uint8_t bitrate;   /* DEV_CFG_BSPD: 0 to 3 fixed 125, 250, 500, 1000 kbit/s, with bit 7
                        * preferred. Undefined: 0x80. */
    uint8_t autostart; /* DEV_CFG_AUTOSTART: 1 enters WORK by itself, 0 waits in CFG. */
} des_settings;

/* Settings of a board that was never configured: no UID, no address, AUTOSTART 0, any bit
 * rate beginning with 125 kbit/s. */
#define DES_SETTINGS_BLANK { { 0u, 0u, 0u, 0u, 0u, 0u }, 0u, 0x80u, 0u }

/* A response of DES: its type byte, 1 or 2, then its text. */
typedef struct {
    const char *bytes;
    uint16_t size; /* 1 to 4095 bytes. */
} des_text;

/* What the device is; constant, usually in flash. */
typedef struct {
    des_text name;     /* As built with DES_NAME_TEXT. */
    des_text services; /* As built with DES_SERVICES_TEXT. */
    uint8_t info[19];  /* Constant fields of the descriptor, as built with DES_INFO. */
} des_device;

/* The text of a name, a string; 5 characters or less fit one classic frame. */
#define DES_NAME_TEXT(name) { "\1" name, sizeof("\1" name) }

/* The text of the services, in the order of their indices; of no services: "". */
#define DES_SERVICES_TEXT(services) { "\2" services, sizeof("\2" services) - 1u }

/* One service: its index as a string of one character ("\0", "\1", ...), its name
 * and its version. A list: DES_SERVICE("\0", "DES", "1.0") DES_SERVICE("\1", "FLOW", "2.1") */
#define DES_SERVICE(index, name, version) index name "\0" version "\0"

/* The bytes of a number, in the order of the bus. */
#if DES_BIG_ENDIAN
#define DES_U16(n) (uint8_t)(((n) >> 8) & 0xFFu), (uint8_t)((n) & 0xFFu)
#define DES_U32(n) DES_U16(((n) >> 16) & 0xFFFFu), DES_U16((n) & 0xFFFFu)
#else
#define DES_U16(n) (uint8_t)((n) & 0xFFu), (uint8_t)(((n) >> 8) & 0xFFu)
#define DES_U32(n) DES_U16((n) & 0xFFFFu), DES_U16(((n) >> 16) & 0xFFFFu)
#endif

/* des_device.info: DEV_INFO_GID as a list of six bytes in parentheses, DEV_INFO_SN
 * (0: none), DEV_INFO_FW_MAJ, DEV_INFO_FW_MIN, bit 0 DEV_INFO_PROG and bit 1
 * DEV_INFO_FPU, DEV_INFO_CPU (1 RV32I, 2 RV32E), DEV_INFO_CPU_FLAGS. A number that is
 * known at run time only: keep the des_device in RAM and change its bytes before
 * des_init; SN is info[6] to [9]. */
#define DES_INFO(gid, sn, major, minor, caps, cpu, flags) \
    { DES_LIST gid, DES_U32(sn), DES_U16(major), DES_U16(minor), caps, DES_U16(cpu), DES_U16(flags) }
#define DES_LIST(a, b, c, d, e, f) a, b, c, d, e, f

/* Transmit buffers. The kit has at most one frame in each, so frames of one
 * identifier never pass each other, and a heartbeat that waits for the bus keeps
 * no response from being sent. Give each a transmit mailbox of its own, or a
 * queue that is sorted by identifier. */
#define DES_SLOT_HEARTBEAT 0u /* Heartbeats and the address claim. */
#define DES_SLOT_RESPONSE 1u  /* All responses. */

/* What became of the frame in a transmit buffer. */
typedef enum {
    DES_TX_PENDING, /* Waits or is being sent. */
    DES_TX_SENT,    /* Sent and acknowledged. */
    DES_TX_FAILED   /* Given up: a DES_FRAME_ONCE frame that lost arbitration or met an
                     * error, an aborted frame. */
} des_tx;

/* Bit of the result of des_port.errors. */
#define DES_ERROR_SEEN 0x200u

/* What the kit informs the firmware of. */
typedef enum {
    DES_EVENT_MODE,     /* Another mode; value: the new one, a DES_MODE_*. After ARSLV the
                         * node has an address, perhaps another one: des_get_address. In
                         * IDLE switch off what can be switched off, in BOOT start the
                         * boot loader. */
    DES_EVENT_IDENTIFY, /* Blink or beep, so that a person finds the device. */
    DES_EVENT_REBOOT    /* Restart the processor. If the function returns, the node begins
                         * again in INIT. */
} des_event;

/* The firmware's functions; all must be set. `user` is that of des_init. */
typedef struct {
    /* Puts a frame into a transmit buffer (DES_SLOT_*), which is empty then. Copies the
     * data. Returns false if that is not possible now; the kit tries again at the next
     * des_poll. */
    bool (*send)(void *user, uint8_t slot, const des_frame *frame);
    /* Returns what became of the frame last put into a transmit buffer. A time-out is not
     * needed: the kit leaves the bus when its error counters are too high. */
    des_tx (*sent)(void *user, uint8_t slot);
    /* Configures the controller: rate 0 to 3 is 125, 250, 500, 1000 kbit/s; silent: it
     * only listens, without acknowledging or sending anything (bxCAN: SILM in BTR, which
     * like the bit rate is set while initialising). Empties both transmit buffers, and
     * resets the error counters, bus-off and what `errors` remembers. */
    void (*bus)(void *user, uint8_t rate, bool silent);
    /* Returns the greater of the controller's two error counters, 256 in bus-off; and
     * DES_ERROR_SEEN if it has detected an error on the bus since the last call (bxCAN:
     * LEC in ESR is neither 0 nor 7; write 7). */
    uint32_t (*errors)(void *user);
    /* Returns bits that differ from board to board: the chip's unique number, an ADC's
     * noise, a free-running counter. Two fresh boards with the same settings meet at one
     * address until their bits differ. */
    uint32_t (*entropy)(void *user);
    /* Reads the settings; DES_SETTINGS_BLANK if none were stored. */
    void (*load)(void *user, des_settings *settings);
    /* Writes the settings. Returns false if they could not be or must not be changed: the
     * request is then refused. Not called without DES_WITH_WRITES. */
    bool (*store)(void *user, const des_settings *settings);
    /* Informs of an event, with its value or 0. */
    void (*event)(void *user, des_event event, uint8_t value);
} des_port;

/* ---- Node ------------------------------------------------------------------ */

/* Modes (CAN platform 3.2.4), with the codes of the bus. */
typedef enum {
    DES_MODE_INIT = DES_CODE_INIT,   /* Looks for the bit rate, listening only. */
    DES_MODE_ARSLV = DES_CODE_ARSLV, /* Resolves its address. */
    DES_MODE_CFG = DES_CODE_CFG,     /* Waits for configuration. */
    DES_MODE_BOOT = DES_CODE_BOOT,   /* As CFG; without firmware, and so without services. */
    DES_MODE_WORK = DES_CODE_WORK,   /* Works. */
    DES_MODE_UFUNC = DES_CODE_UFUNC, /* Works, with an error that prevents its task. */
    DES_MODE_IDLE = DES_CODE_IDLE    /* Saves energy. Heartbeats go on, requests but that to
                                      * change the mode are not served. */
} des_mode;

/* One requester that is being served. Private. */
typedef struct {
    uint32_t at;      /* When to send next, or when flow control is overdue. */
    uint32_t state;
    uint32_t current; /* The request that is being answered, a bit of `pending`; 0: none. */
    uint32_t pending; /* Requests to answer, one bit each. */
    uint32_t command; /* SRV of the response to a command, and whether it is refused. */
    uint16_t sent;    /* Bytes of the response that were sent. */
    uint8_t sequence; /* Of the next consecutive frame. */
    uint8_t block;    /* Frames until the next flow control, 0: no further one; while waiting
                       * for it: flow controls with WAIT in a row. */
    uint8_t st_min;   /* Least time between two frames, in milliseconds. */
    uint8_t value;    /* Of a command: its data. */
    uint8_t peer;     /* Address of the requester. */
    uint8_t flags;    /* Of its requests' frames. */
} des_requester;

/* A node. Its members are private but for `dropped`: use the functions below. */
typedef struct {
    const des_port *port;
    void *user;
    const des_device *device;
    uint32_t until;     /* End of the stage; in RUN when the next heartbeat is due. */
    uint32_t stage;
    uint32_t mode;
    uint32_t wish;      /* Mode to be entered with the next des_poll. */
    uint32_t own;       /* U and SRC of its identifiers. */
    uint32_t busy;      /* Transmit buffers with a frame, one bit each. */
    uint32_t random;    /* State of the generator. */
    des_requester *turn;    /* Requester whose frame was sent last. */
    uint32_t in_use[4]; /* Addresses in use, one bit each. */
    des_requester requesters[DES_REQUESTERS];
    uint8_t limit;
    uint8_t error;
    uint8_t uid_in_use; /* Heartbeats until a working node with the same UID is forgotten. */
    uint8_t dropped;    /* Requests that were dropped, modulo 256: more than DES_REQUESTERS
                         * requesters, or a command before that before was answered. */
    des_settings settings;
    uint8_t rate;
} des_node;

/* Prepares a node that begins in INIT with the next des_poll: after power-on, once. Loads the
 * settings. `port` and `device` stay in use; `user` is passed to the functions of `port`. */
void des_init(des_node *node, const des_port *port, const des_device *device, void *user);

/* Takes a received frame, in the order of reception; des_poll should follow soon. Frames
 * that the controller itself sent are not passed. Returns true if the frame is for the
 * application: a request to this node, in its mode, of a service that the kit does not
 * serve; or a response or unsolicited data of another node. The application answers a
 * targeted request in any case (ERR = 0 if it cannot): see des_response_id. */
bool des_receive(des_node *node, const des_frame *frame, uint32_t now);

/* Sends what is due. Call it when the time that it returned the last time is over, after
 * des_receive, and after a transmission ended. Returns the microseconds until it must be
 * called again, at most one heartbeat period. */
uint32_t des_poll(des_node *node, uint32_t now);

/* Changes the mode with the next des_poll, as a command from the bus does: INIT begins again,
 * ARSLV resolves the address anew; the others need an address, and WORK and UFUNC also a
 * configured address, a UID that is not blank and not used by a working node, and des_set_limit
 * to permit them. INIT that is pending (after des_init, after bus errors) comes first, and so does
 * another user of the address: then nothing is changed. DES_EVENT_MODE informs of the mode that
 * was entered. */
static inline void des_set_mode(des_node *node, des_mode mode)
{
    bool is_pending = (node->wish == (uint32_t)DES_MODE_INIT) || (node->wish > 0xFFu);

    if (!is_pending || (mode == DES_MODE_INIT)) {
        node->wish = (uint32_t)mode;
    }
}

/* Limits what the node enters: DES_MODE_WORK (no limit, as after des_init), DES_MODE_CFG
 * (supply voltage for configuration only, failed self-test) or DES_MODE_BOOT (no
 * firmware). A node beyond the limit changes its mode with the next des_poll. */
static inline void des_set_limit(des_node *node, des_mode limit)
{
    node->limit = (uint8_t)limit;
}

/* Sets the error code of the heartbeat; 0: none. A working node is in UFUNC while it is not
 * 0, in WORK otherwise, from the next des_poll. */
static inline void des_set_error(des_node *node, uint8_t error)
{
    node->error = error;
}

/* Returns a random number, for RND7 and delays of the application: use its high bits. */
uint32_t des_random(des_node *node);

/* ---- Identifiers, for the application ------------------------------------------ */

#define DES_ID_U 0x10000000u   /* The sender does not work. */
#define DES_ID_D 0x08000000u   /* Addressed to nodes that do not work. */
#define DES_ID_R 0x04000000u   /* Response. */
#define DES_ID_B 0x02000000u   /* Broadcast: DST is a random number. */
#define DES_ID_ERR 0x01000000u /* In a response: no error. */

/* Returns SRC, DST and SRV of an identifier. */
static inline uint8_t des_id_source(uint32_t id)
{
    return (uint8_t)((id >> 17) & 0x7Fu);
}

static inline uint8_t des_id_destination(uint32_t id)
{
    return (uint8_t)((id >> 10) & 0x7Fu);
}

static inline uint16_t des_id_service(uint32_t id)
{
    return (uint16_t)(id & 0x3FFu);
}

/* Returns true if an identifier is of one of the nine message types (CAN platform 4.3). */
static inline bool des_id_is_conforming(uint32_t id)
{
    uint32_t flags = (id >> 24) & 0x1Fu;

    /* One bit for each combination of U, D, R, B and ERR; the last one is DEBUG. */
    return (((0x80F00FFFu >> flags) & 1u) != 0u)
        && ((flags != 0x1Fu) || (des_id_destination(id) == 127u));
}

/* Returns the mode. */
static inline des_mode des_get_mode(const des_node *node)
{
    return (des_mode)node->mode;
}

/* Returns true in WORK and UFUNC: the node may send requests. */
static inline bool des_is_working(const des_node *node)
{
    return (node->own & DES_ID_U) == 0u;
}

/* Returns the node's address; 0 in INIT and ARSLV, when it has none and must not send. */
static inline uint8_t des_get_address(const des_node *node)
{
    bool has_none = (node->mode == (uint32_t)DES_MODE_INIT)
        || (node->mode == (uint32_t)DES_MODE_ARSLV);

    return has_none ? 0u : des_id_source(node->own);
}

/* Returns the identifier of the response to a request; ok = false: with ERR = 0. */
static inline uint32_t des_response_id(const des_node *node, uint32_t request, bool ok)
{
    return node->own | DES_ID_R | (ok ? DES_ID_ERR : 0u)
        | ((uint32_t)des_id_source(request) << 10) | des_id_service(request);
}

/* Returns the identifier of unsolicited data to all, with a new random DST. */
static inline uint32_t des_unsolicited_id(des_node *node, uint16_t service)
{
    return node->own | DES_ID_R | DES_ID_B | DES_ID_ERR | ((des_random(node) >> 25) << 10)
        | service;
}

/* Returns the identifier of a request to one working node. Only working nodes send it. */
static inline uint32_t des_request_id(const des_node *node, uint8_t to, uint16_t service)
{
    return node->own | ((uint32_t)to << 10) | service;
}

/* An acceptance filter: a frame passes if (id & mask) == filter id. */
typedef struct {
    uint32_t id;
    uint32_t mask;
} des_filter;

/* Returns the number of filters that together pass all that the kit needs, and writes them
 * to filters[0] to [4]. To be set when the node has an address (DES_EVENT_MODE); before,
 * in INIT and ARSLV, it needs all frames: set no filter in des_port.bus. */
static inline uint8_t des_filters(uint8_t address, des_filter filters[5])
{
    filters[0].id = (uint32_t)address << 17; /* From its own address: a conflict. */
    filters[0].mask = (uint32_t)0x7Fu << 17;
    filters[1].id = (uint32_t)address << 10; /* Requests to it. */
    filters[1].mask = DES_ID_R | DES_ID_B | ((uint32_t)0x7Fu << 10);
    filters[2].id = DES_ID_R | ((uint32_t)address << 10); /* Responses to its requests. */
    filters[2].mask = DES_ID_R | DES_ID_B | ((uint32_t)0x7Fu << 10);
    filters[3].id = DES_ID_B | DES_SRV_DES; /* DES requests to all. */
    filters[3].mask = DES_ID_R | DES_ID_B | 0x3FFu;
    filters[4].id = DES_ID_R | DES_SRV_HEARTBEAT; /* Heartbeats: UIDs. */
    filters[4].mask = DES_ID_R | 0x3FFu;
    return 5u;
}

#ifdef __cplusplus
}
#endif

#endif
