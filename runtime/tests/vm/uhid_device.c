// A virtual force-feedback device in a real kernel: /dev/uhid makes a hidraw node that speaks the native report
// (docs/devices.md). Runs inside the virtual machine of scripts/test_hidraw_vm.
//
//     uhid_device PERIODS [UNPLUG_AT]     one report per millisecond; then one line: what came and went
#include <errno.h>
#include <fcntl.h>
#include <linux/uhid.h>
#include <math.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static const unsigned char descriptor[] = {0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08,
                                           0x95, 0x40, 0x09, 0x02, 0x81, 0x02, 0x95, 0x40, 0x09, 0x03, 0x91, 0x02, 0xC0};

static uint16_t crc16(const uint8_t *bytes, int count) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < count; ++i) {
        crc = (uint16_t)(crc ^ (bytes[i] << 8));
        for (int bit = 0; bit < 8; ++bit) crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

int main(int argc, char **argv) {
    const int periods = argc > 1 ? atoi(argv[1]) : 1000, unplug_at = argc > 2 ? atoi(argv[2]) : -1;
    const int fd = open("/dev/uhid", O_RDWR | O_CLOEXEC);
    if (fd < 0) return perror("/dev/uhid"), 77;
    struct uhid_event event = {.type = UHID_CREATE2};
    strcpy((char *)event.u.create2.name, "virtual stylus");
    strcpy((char *)event.u.create2.uniq, "SIM0001");
    memcpy(event.u.create2.rd_data, descriptor, sizeof descriptor);
    event.u.create2.rd_size = sizeof descriptor;
    event.u.create2.bus = 0x03;
    event.u.create2.vendor = 0x1209;
    event.u.create2.product = 0x0001;
    if (write(fd, &event, sizeof event) != sizeof event) return perror("UHID_CREATE2"), 1;

    uint32_t seq = 0, echo = 0, forces = 0, bad = 0, wrong_length = 0, last = 0, gaps = 0;
    int opens = 0, sent = 0, unplugged = 0;
    float most = 0.0f, force[3] = {0};
    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (int idle = 0; sent < periods && idle < 20000;) {
        next.tv_nsec += 1000000;
        if (next.tv_nsec >= 1000000000) next.tv_nsec -= 1000000000, ++next.tv_sec;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        struct pollfd input = {fd, POLLIN, 0};
        while (poll(&input, 1, 0) > 0 && read(fd, &event, sizeof event) > 0) {
            if (event.type == UHID_OPEN) ++opens;
            if (event.type == UHID_CLOSE) --opens;
            if (event.type != UHID_OUTPUT) continue;
            const uint8_t *report = event.u.output.data + 1;  // the report id comes first
            uint16_t crc;
            if (event.u.output.size != 65) {
                ++wrong_length;
                continue;
            }
            memcpy(&crc, report + 62, 2);
            if (crc != crc16(report, 62)) {
                ++bad;
                continue;
            }
            memcpy(&echo, report, 4);
            memcpy(force, report + 4, 12);
            if (forces > 0 && echo != last + 1) ++gaps;
            last = echo;
            ++forces;
            for (int i = 0; i < 3; ++i) most = fabsf(force[i]) > most ? fabsf(force[i]) : most;
        }
        if (opens <= 0) {
            if (sent > 0) break;  // the station has gone
            ++idle;
            continue;
        }
        if (sent == unplug_at) {
            unplugged = 1;
            break;
        }
        // Down into the plate within a tenth of a second, then half a millimetre in.
        const float z = sent < 500 ? 1.0f : sent < 600 ? 1.0f - 0.015f * (float)(sent - 500) : -0.5f;
        const float position[3] = {0.3f, 0.0f, z};
        const uint16_t status = 1 << 4;
        const uint32_t t_us = 1000u * (uint32_t)sent;
        memset(&event, 0, sizeof event);
        event.type = UHID_INPUT2;
        event.u.input2.size = 64;
        ++seq;
        memcpy(event.u.input2.data, &seq, 4);
        memcpy(event.u.input2.data + 4, &t_us, 4);
        memcpy(event.u.input2.data + 8, position, 12);
        memcpy(event.u.input2.data + 34, &status, 2);
        memcpy(event.u.input2.data + 36, &echo, 4);
        if (write(fd, &event, sizeof event) == sizeof event) ++sent;
    }
    event.type = UHID_DESTROY;
    if (write(fd, &event, sizeof event) < 0) perror("UHID_DESTROY");
    printf("DEVICE sent=%d forces=%u bad=%u wrong_length=%u gaps=%u most_n=%.3f last_n=%.3f unplugged=%d\n", sent, forces, bad,
           wrong_length, gaps, (double)most, (double)fabsf(force[2]), unplugged);
    return 0;
}
