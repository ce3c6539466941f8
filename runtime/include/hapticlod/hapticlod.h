/*
 * HapticLOD: haptic rendering of a scan with velocity-driven levels of detail.
 *
 * This header is the whole public interface and its manual. It is plain C99; link with libhapticlod (CMake:
 * find_package(HapticLOD), target HapticLOD::hapticlod; pkg-config: hapticlod). docs/embedding.md has whole programs.
 *
 *     hlod_bundle* bundle = NULL;
 *     hlod_renderer* renderer = NULL;
 *     char message[256];
 *     if (hlod_bundle_open("jaw.hlod", &bundle, message, sizeof message) != HLOD_OK ||
 *         hlod_renderer_create(bundle, NULL, &renderer, message, sizeof message) != HLOD_OK) {
 *         fprintf(stderr, "%s\n", message);
 *         return 2;
 *     }
 *     while (running) {                         // at the bundle's rate, hlod_info.loop_hz
 *         hlod_record record;
 *         device_read(position_mm, &time_s);    // your device, its own clock
 *         hlod_tick(renderer, time_s, position_mm, NULL, &record);
 *         device_write(record.force_n);
 *     }
 *     hlod_renderer_destroy(renderer);
 *     hlod_bundle_close(bundle);
 *
 * Units and frames. Millimetres, seconds, newtons, everywhere. Positions and forces are in the scan's frame: bring your
 * device's frame there first. The position is the device's place of the tool's reference point (HIP): for a ball tool
 * the ball's centre, for a point probe its tip. Orientations are unit quaternions w, x, y, z, tool frame to scan frame.
 *
 * Time. hlod_tick takes the device's own time stamp, not the time of the call: speed comes from it. It must increase;
 * where it does not, the bundle's nominal period is used and HLOD_ERR_PERIOD is set.
 *
 * Errors. Functions that can fail return an hlod_status; those that read a file or build something also write one line,
 * "where: what; remedy", into the caller's buffer (always terminated; message may be NULL when message_bytes is 0).
 * hlod_tick does not fail once its arguments are valid: what went wrong is in hlod_record.errors, and the force is
 * always finite and within the limits of the bundle. No function throws, aborts, prints, or keeps global state.
 *
 * Threads. A bundle is read-only after opening: any number of threads and renderers may share it. A renderer belongs to
 * one thread at a time. hlod_tick, hlod_reset and hlod_set_coarsest_floor allocate nothing, take no lock and make no
 * system call; all others may do any of these and do not belong into the loop. Every object is closed once, and
 * closing NULL does nothing. A renderer keeps what it needs of its bundle: the bundle may be closed first.
 *
 * Real time. Opening maps the file; call mlockall(MCL_CURRENT | MCL_FUTURE) before or after, or the first touch of a
 * page costs a page fault inside the loop.
 *
 * Trust. Opening proves that a bundle is undamaged and, where it is signed, that the signature is right. Whether you
 * believe the signer is your decision: hlod_bundle_trusted asks a file of trusted keys, as hapticlod-station does.
 *
 * Safety. The force is limited as the bundle says, but this library knows nothing of your device: check its reports,
 * its watchdog and its stability limit yourself (docs/bundle.md, hapticlod-station).
 *
 * Versions. HLOD_ABI_VERSION changes when a struct or a function changes in a way that old callers would notice. New
 * fields are only ever added at the end of a struct that carries struct_bytes, and new functions beside the old.
 */
#ifndef HAPTICLOD_HAPTICLOD_H
#define HAPTICLOD_HAPTICLOD_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#define HLOD_NOEXCEPT noexcept
#else
#define HLOD_NOEXCEPT
#endif

#if defined(__GNUC__)
#define HLOD_API __attribute__((visibility("default")))
#else
#define HLOD_API
#endif

#define HLOD_ABI_VERSION 1u
#define HLOD_MAX_LEVELS 8u

typedef struct hlod_bundle hlod_bundle;
typedef struct hlod_renderer hlod_renderer;

typedef enum hlod_status {
    HLOD_OK = 0,
    HLOD_BAD_ARGUMENT = 1, /* NULL where none is allowed, or a struct_bytes that this library does not know */
    HLOD_BAD_BUNDLE = 2,   /* the file is missing, damaged, or too new; the message says which */
    HLOD_BAD_OPTION = 3,   /* an option of hlod_options cannot be used */
    HLOD_NO_MEMORY = 4,
    HLOD_INTERNAL = 5, /* a fault of this library */
    HLOD_UNTRUSTED = 6 /* the bundle is unsigned, or signed by a key that is not (or no longer) trusted */
} hlod_status;

/* Bits of hlod_record.errors. */
enum {
    HLOD_ERR_HIP_NOT_FINITE = 1u << 0,   /* position or orientation was NaN or infinite: the last pose was held */
    HLOD_ERR_PERIOD = 1u << 1,           /* time did not advance: the nominal period was used */
    HLOD_ERR_HIP_JUMP = 1u << 2,         /* the position moved further than the scan is large: contact was reset */
    HLOD_ERR_NOT_CONVERGED = 1u << 3,    /* the contact is safe but not final */
    HLOD_ERR_CANDIDATES = 1u << 4,       /* more nearby triangles than the scratch holds: the reach was shortened */
    HLOD_ERR_CONTACT_LOST = 1u << 5,     /* a change of level in contact found no surface */
    HLOD_ERR_FORCE_CLAMPED = 1u << 6,    /* the force limit was reached */
    HLOD_ERR_SLEW_LIMITED = 1u << 7,     /* the limit of force per second was reached */
    HLOD_ERR_FORCE_NOT_FINITE = 1u << 8, /* the force was not finite: 0 is given */
    HLOD_ERR_START_INSIDE = 1u << 9,     /* the tool started inside the surface: engaged softly */
    HLOD_ERR_TURN_HELD = 1u << 10        /* a turn would have passed through the surface: orientation was held */
};

/* hlod_record.mapping: what the change of level did to the contact. */
enum { HLOD_MAPPING_NONE = 0, HLOD_MAPPING_HIT = 1, HLOD_MAPPING_CLOSEST = 2, HLOD_MAPPING_MISS = 3 };

/* What one tick gave. 144 bytes, the same as in a bundle's golden record. */
typedef struct hlod_record {
    double time_s;
    double hip_mm[3];       /* where the device is */
    double scp_mm[3];       /* where the rendered tool is: never inside the surface */
    double force_n[3];      /* to be sent to the device */
    double torque_n_mm[3];  /* about the tool's reference point */
    float speed_mm_s;       /* filtered, the one that chose the level */
    float cost_ns;          /* 0: time the call yourself */
    uint8_t level;          /* 0 is the finest */
    uint8_t contact;        /* 1 in contact */
    uint8_t mapping;        /* HLOD_MAPPING_* */
    uint8_t constraints;    /* active constraints, 0 to 3 */
    uint32_t errors;        /* HLOD_ERR_* */
    uint32_t cells;         /* work of this tick, the same numbers on every machine: hash cells visited */
    uint32_t triangles;     /* triangles gathered from cells */
    uint32_t tests;         /* triangle distances computed */
    uint32_t iterations;    /* constraint iterations */
    uint32_t balls;         /* balls whose safe distance was renewed */
    uint32_t mapping_cells; /* the part of cells that mapping visited */
} hlod_record;

/* What a bundle holds. Set struct_bytes = sizeof(hlod_info) before the call. */
typedef struct hlod_info {
    size_t struct_bytes;
    uint32_t level_count;
    uint32_t ball_count; /* of the tool */
    double loop_hz;      /* the rate the bundle was tuned for */
    double budget_us;    /* what a tick may cost */
    double stiffness_n_mm;
    double max_force_n;
    double origin_mm[3];                 /* centre of the scan's bounding box, scan frame */
    uint64_t triangles[HLOD_MAX_LEVELS]; /* level 0, the finest, first */
    double speeds_mm_s[HLOD_MAX_LEVELS]; /* speed i lies between level i and level i + 1 */
    uint64_t golden_ticks;               /* rows of the golden motion and record; 0: the bundle has none */
} hlod_info;

/* How a renderer differs from what its bundle says. Set struct_bytes = sizeof(hlod_options), the rest to 0. */
typedef struct hlod_options {
    size_t struct_bytes;
    double stiffness_n_mm; /* 0: the bundle's. Lower it to what your device can render stably */
    double max_force_n;    /* 0: the bundle's; never raised above it */
    double loop_hz;        /* 0: the bundle's */
} hlod_options;

/* The version this library was built with; differs from HLOD_ABI_VERSION when header and library do not match. */
HLOD_API uint32_t hlod_abi_version(void) HLOD_NOEXCEPT;

/* Opens and checks a bundle: structure, digests, and every index and number in it. A large one is read by several
 * threads, which are gone when this returns. */
HLOD_API hlod_status hlod_bundle_open(const char* path, hlod_bundle** bundle, char* message,
                                      size_t message_bytes) HLOD_NOEXCEPT;

/* The same, quick from the second time on: the large arrays of a file that was found right since the machine was
 * started and was not written since are not read again. record_path is where that is kept, a file of this user's own;
 * NULL: in the user's cache folder, as hapticlod-station does. Without a place for it this is hlod_bundle_open. */
HLOD_API hlod_status hlod_bundle_open_known(const char* path, const char* record_path, hlod_bundle** bundle,
                                            char* message, size_t message_bytes) HLOD_NOEXCEPT;

/* hlod_bundle_open for a bundle in memory: `data` at a multiple of 64 bytes, unchanged and alive until bundle and
 * renderers are closed. `name` is for messages and may be NULL. */
HLOD_API hlod_status hlod_bundle_open_memory(const void* data, size_t bytes, const char* name, hlod_bundle** bundle,
                                             char* message, size_t message_bytes) HLOD_NOEXCEPT;
HLOD_API void hlod_bundle_close(hlod_bundle* bundle) HLOD_NOEXCEPT;
HLOD_API hlod_status hlod_bundle_info(const hlod_bundle* bundle, hlod_info* info) HLOD_NOEXCEPT;

/* HLOD_OK where the bundle is signed by a key in the file (lines: ed25519 BASE64 name [until=YYYY-MM-DD]), else
 * HLOD_UNTRUSTED; HLOD_BAD_ARGUMENT where the file cannot be used. The message says who signed, or why not.
 * trusted_keys_path may be NULL: /etc/hapticlod/trusted_keys and ~/.config/hapticlod/trusted_keys. */
HLOD_API hlod_status hlod_bundle_trusted(const hlod_bundle* bundle, const char* trusted_keys_path, char* message,
                                         size_t message_bytes) HLOD_NOEXCEPT;

/* The manifest: JSON, UTF-8, terminated, valid until the bundle is closed. NULL when bundle is NULL. */
HLOD_API const char* hlod_bundle_manifest(const hlod_bundle* bundle) HLOD_NOEXCEPT;

/* Row `tick` of the golden motion and what the reference machine rendered there. Either output may be NULL.
 * Replaying the motion from row 0 on a fresh renderer without options gives the record again, cost_ns apart. */
HLOD_API hlod_status hlod_bundle_golden(const hlod_bundle* bundle, uint64_t tick, double* time_s, double position_mm[3],
                                        double orientation_wxyz[4], hlod_record* record) HLOD_NOEXCEPT;

/* A renderer for one tool in one loop. options may be NULL. */
HLOD_API hlod_status hlod_renderer_create(const hlod_bundle* bundle, const hlod_options* options,
                                          hlod_renderer** renderer, char* message, size_t message_bytes) HLOD_NOEXCEPT;
HLOD_API void hlod_renderer_destroy(hlod_renderer* renderer) HLOD_NOEXCEPT;

/* One pass of the loop. orientation_wxyz may be NULL: the tool keeps the scan's axes.
 * Returns HLOD_BAD_ARGUMENT, and does nothing, only for a NULL renderer, position or record. */
HLOD_API hlod_status hlod_tick(hlod_renderer* renderer, double time_s, const double position_mm[3],
                               const double orientation_wxyz[4], hlod_record* record) HLOD_NOEXCEPT;

/* Forgets contact, speed and blend: the next tick starts as the first. */
HLOD_API void hlod_reset(hlod_renderer* renderer) HLOD_NOEXCEPT;

/* From the next tick on use at least this level, whatever the speed, until called again; 0 lifts it. For overruns. */
HLOD_API void hlod_set_coarsest_floor(hlod_renderer* renderer, uint32_t level) HLOD_NOEXCEPT;

#ifdef __cplusplus
}
#endif

#endif
