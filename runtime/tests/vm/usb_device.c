// A virtual USB device in a real kernel: vhci_hcd, the host side of USB/IP, is given one end of a socket pair and sees
// a full-speed HID device that speaks the native report (docs/devices.md). Where uhid begins above the USB driver, this
// has usbhid, its interrupt endpoints and its SET_REPORT under test. Runs inside the virtual machine of
// scripts/test_device_vm; no network is involved.
//
//     usb_device [--no-out] PERIODS [UNPLUG_AT]     then one line: what came and went
//
// --no-out: no interrupt OUT endpoint; the kernel sends forces as SET_REPORT over endpoint 0.
//
// USB/IP: Documentation/usb/usbip_protocol.rst of the kernel. Numbers are big-endian.
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "native_stylus.h"

enum { kSubmit = 1, kUnlink = 2, kSubmitted = 3, kUnlinked = 4 };
enum { kParked = 16 };

struct Header {  // of all four messages, 48 bytes
    uint32_t command, seq, devid, direction, endpoint;
    union {
        struct {
            uint32_t flags, length, start_frame, packets, interval;
            uint8_t setup[8];
        } submit;
        struct {
            uint32_t status, length, start_frame, packets, errors;
        } submitted;
        uint32_t unlink_seq;
        uint32_t rest[7];
    };
};
_Static_assert(sizeof(struct Header) == 48, "usbip_header");

static struct Stylus stylus;
static int host = -1, has_out = 1, configured = 0;
static uint32_t in_seq;                        // of the read that waits for a report; 0: none
static uint32_t out_seq[kParked], out_length[kParked];  // writes that are answered in the next frame
static uint32_t set_reports;

static void send_all(const void *bytes, size_t count) {
    if (send(host, bytes, count, MSG_NOSIGNAL) != (ssize_t)count) perror("socket");
}

static int receive_all(void *bytes, size_t count) { return recv(host, bytes, count, MSG_WAITALL) == (ssize_t)count; }

static void answer(uint32_t seq, int status, uint32_t length, const void *data, size_t data_bytes) {
    uint8_t message[sizeof(struct Header) + 256];
    struct Header header = {.command = htonl(kSubmitted), .seq = htonl(seq)};
    header.submitted.status = htonl((uint32_t)status);
    header.submitted.length = htonl(length);
    memcpy(message, &header, sizeof header);
    memcpy(message + sizeof header, data, data_bytes);
    send_all(message, sizeof header + data_bytes);
}

static void park(uint32_t seq, uint32_t length) {
    for (int i = 0; i < kParked; ++i) {
        if (out_seq[i] != 0) continue;
        out_seq[i] = seq, out_length[i] = length;
        return;
    }
    answer(seq, -EPIPE, 0, "", 0);
}

static size_t string_descriptor(unsigned index, uint8_t *out) {
    static const char *const kStrings[] = {"", "hapticlod", "virtual stylus", "SIM0002"};
    if (index == 0) return memcpy(out, (uint8_t[]){4, 3, 0x09, 0x04}, 4), 4;  // English
    if (index > 3) return 0;
    const size_t letters = strlen(kStrings[index]);
    out[0] = (uint8_t)(2 + 2 * letters), out[1] = 3;
    for (size_t i = 0; i < letters; ++i) out[2 + 2 * i] = (uint8_t)kStrings[index][i], out[3 + 2 * i] = 0;
    return out[0];
}

// Fills `out`; 0: this device has no such descriptor.
static size_t descriptor(unsigned type, unsigned index, uint8_t *out) {
    static const uint8_t kDevice[18] = {18, 1, 0x00, 0x02, 0, 0, 0, 64, 0x09, 0x12, 0x01, 0x00, 0x00, 0x01, 1, 2, 3, 1};
    // Configuration; interface of class HID; HID 1.11; endpoint 1 IN and endpoint 1 OUT, interrupt, 64 bytes, 1 ms.
    uint8_t configuration[41] = {9, 2, 41, 0, 1, 1, 0, 0x80, 50,                               //
                                 9, 4, 0, 0, 2, 3, 0, 0, 0,                                    //
                                 9, 0x21, 0x11, 1, 0, 1, 0x22, sizeof kReportDescriptor, 0,  //
                                 7, 5, 0x81, 3, 64, 0, 1,                                      //
                                 7, 5, 0x01, 3, 64, 0, 1};
    if (!has_out) configuration[2] = 34, configuration[13] = 1;
    switch (type) {
        case 1:
            return memcpy(out, kDevice, sizeof kDevice), sizeof kDevice;
        case 2:
            return memcpy(out, configuration, configuration[2]), configuration[2];
        case 3:
            return string_descriptor(index, out);
        case 0x22:
            return memcpy(out, kReportDescriptor, sizeof kReportDescriptor), sizeof kReportDescriptor;
        default:
            return 0;
    }
}

static void control(uint32_t seq, const uint8_t setup[8], const uint8_t *data) {
    const unsigned type = setup[0], request = setup[1], index = setup[2], kind = setup[3];
    const unsigned length = setup[6] | setup[7] << 8;
    uint8_t out[256];
    size_t bytes = 0;
    if (type == 0x21 && request == 9) {  // SET_REPORT
        ++set_reports;
        take_force(&stylus, data, (int)length);
        park(seq, length);
        return;
    }
    if ((type & 0x80) == 0) {
        if (type == 0 && request == 9) configured = 1;  // SET_CONFIGURATION
        answer(seq, 0, length, "", 0);
        return;
    }
    if (request == 6) bytes = descriptor(kind, index, out);                  // GET_DESCRIPTOR
    if (type == 0x80 && request == 0) bytes = 2, memset(out, 0, 2);          // GET_STATUS
    if (type == 0xA1 && request == 1) bytes = 64, memset(out, 0, bytes);     // GET_REPORT
    if (bytes > length) bytes = length;
    answer(seq, bytes == 0 && length > 0 ? -EPIPE : 0, (uint32_t)bytes, out, bytes);
}

static void unlink_urb(uint32_t seq, uint32_t which) {
    struct Header header = {.command = htonl(kUnlinked), .seq = htonl(seq)};
    int found = in_seq == which;
    if (found) in_seq = 0;
    for (int i = 0; i < kParked; ++i) {
        if (out_seq[i] == which) out_seq[i] = 0, found = 1;
    }
    header.submitted.status = htonl((uint32_t)(found ? -ECONNRESET : 0));
    send_all(&header, sizeof header);
}

// One message of the host's. False where there will be none any more.
static int serve(void) {
    struct Header header;
    uint8_t data[1024];
    if (!receive_all(&header, sizeof header)) return 0;
    const uint32_t seq = ntohl(header.seq), length = ntohl(header.submit.length), endpoint = ntohl(header.endpoint);
    if (ntohl(header.command) == kUnlink) return unlink_urb(seq, ntohl(header.unlink_seq)), 1;
    const int to_device = ntohl(header.direction) == 0;
    if (to_device && length > 0 && (length > sizeof data || !receive_all(data, length))) return 0;
    if (endpoint == 0) {
        control(seq, header.submit.setup, data);
    } else if (to_device) {
        take_force(&stylus, data, (int)length);
        park(seq, length);
    } else {
        in_seq = seq;
    }
    return 1;
}

static int attach(int socket) {
    char line[64];
    const int file = open("/sys/devices/platform/vhci_hcd.0/attach", O_WRONLY | O_CLOEXEC);
    const int bytes = snprintf(line, sizeof line, "0 %d %d 2", socket, 1 << 16 | 1);  // port, socket, device, full speed
    int good = 0;
    for (int tries = 0; file >= 0 && !good && tries < 200; ++tries) {  // the port may still be letting go of the last one
        good = write(file, line, (size_t)bytes) == bytes;
        if (!good) usleep(10000);
    }
    if (!good) perror("vhci_hcd attach");
    if (file >= 0) close(file);
    return good;
}

int main(int argc, char **argv) {
    int at = 1, ends[2];
    if (argc > at && strcmp(argv[at], "--no-out") == 0) has_out = 0, ++at;
    const uint32_t periods = argc > at ? (uint32_t)atoi(argv[at]) : 1000;
    const uint32_t unplug_at = argc > at + 1 ? (uint32_t)atoi(argv[at + 1]) : UINT32_MAX;
    if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends) != 0 || !attach(ends[0])) return 77;
    close(ends[0]);  // the kernel has it
    host = ends[1];

    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (int idle = 0; stylus.sent < periods && idle < 20000;) {  // a frame of 1 ms each
        next.tv_nsec += 1000000;
        if (next.tv_nsec >= 1000000000) next.tv_nsec -= 1000000000, ++next.tv_sec;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        for (int i = 0; i < kParked; ++i) {
            if (out_seq[i] != 0) answer(out_seq[i], 0, out_length[i], "", 0);
            out_seq[i] = 0;
        }
        struct pollfd input = {host, POLLIN, 0};
        while (poll(&input, 1, 0) > 0) {
            if (!serve()) return fputs("the host has gone\n", stderr), 1;
        }
        if (in_seq == 0) {  // nobody has the device open, or its answer is on the way
            if (++idle > 100 && stylus.sent > 0) break;
            continue;
        }
        idle = 0;
        if (stylus.sent == unplug_at) {
            stylus.unplugged = 1;
            break;
        }
        uint8_t report[kReportBytes];
        next_report(&stylus, report);
        answer(in_seq, 0, kReportBytes, report, kReportBytes);
        in_seq = 0;
    }
    shutdown(host, SHUT_RDWR);  // the cable
    char more[64];
    snprintf(more, sizeof more, " configured=%d set_reports=%u", configured, set_reports);
    print_stylus(&stylus, more);
    return 0;
}
