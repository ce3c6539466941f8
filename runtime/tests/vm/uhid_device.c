// A virtual force-feedback device in a real kernel: /dev/uhid makes a hidraw node that speaks the native report
// (docs/devices.md). Runs inside the virtual machine of scripts/test_device_vm.
//
//     uhid_device PERIODS [UNPLUG_AT]     one report per millisecond; then one line: what came and went
#include <fcntl.h>
#include <linux/uhid.h>
#include <poll.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

#include "native_stylus.h"

int main(int argc, char **argv) {
    const uint32_t periods = argc > 1 ? (uint32_t)atoi(argv[1]) : 1000;
    const uint32_t unplug_at = argc > 2 ? (uint32_t)atoi(argv[2]) : UINT32_MAX;
    const int fd = open("/dev/uhid", O_RDWR | O_CLOEXEC);
    if (fd < 0) return perror("/dev/uhid"), 77;
    struct uhid_event event = {.type = UHID_CREATE2};
    strcpy((char *)event.u.create2.name, "virtual stylus");
    strcpy((char *)event.u.create2.uniq, "SIM0001");
    memcpy(event.u.create2.rd_data, kReportDescriptor, sizeof kReportDescriptor);
    event.u.create2.rd_size = sizeof kReportDescriptor;
    event.u.create2.bus = 0x03;
    event.u.create2.vendor = 0x1209;
    event.u.create2.product = 0x0001;
    if (write(fd, &event, sizeof event) != sizeof event) return perror("UHID_CREATE2"), 1;

    struct Stylus stylus = {0};
    int opens = 0;
    struct timespec next;
    clock_gettime(CLOCK_MONOTONIC, &next);
    for (int idle = 0; stylus.sent < periods && idle < 20000;) {
        next.tv_nsec += 1000000;
        if (next.tv_nsec >= 1000000000) next.tv_nsec -= 1000000000, ++next.tv_sec;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, NULL);
        struct pollfd input = {fd, POLLIN, 0};
        while (poll(&input, 1, 0) > 0 && read(fd, &event, sizeof event) > 0) {
            if (event.type == UHID_OPEN) ++opens;
            if (event.type == UHID_CLOSE) --opens;
            // The report id comes first.
            if (event.type == UHID_OUTPUT) take_force(&stylus, event.u.output.data + 1, event.u.output.size - 1);
        }
        if (opens <= 0) {
            if (stylus.sent > 0) break;  // the station has gone
            ++idle;
            continue;
        }
        if (stylus.sent == unplug_at) {
            stylus.unplugged = 1;
            break;
        }
        memset(&event, 0, sizeof event);
        event.type = UHID_INPUT2;
        event.u.input2.size = kReportBytes;
        next_report(&stylus, event.u.input2.data);
        if (write(fd, &event, sizeof event) != sizeof event) perror("UHID_INPUT2");
    }
    event.type = UHID_DESTROY;
    if (write(fd, &event, sizeof event) < 0) perror("UHID_DESTROY");
    print_stylus(&stylus, "");
    return 0;
}
