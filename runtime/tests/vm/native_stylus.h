// What the virtual devices of scripts/test_device_vm share: a hand that presses into a plate, the native report
// (docs/devices.md), and a count of what came back.
#pragma once
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

enum { kReportBytes = 64 };

// Vendor page, one collection of 64 bytes in and 64 bytes out, no report id.
static const uint8_t kReportDescriptor[] = {0x06, 0x00, 0xFF, 0x09, 0x01, 0xA1, 0x01, 0x15, 0x00,
                                            0x26, 0xFF, 0x00, 0x75, 0x08, 0x95, 0x40, 0x09, 0x02,
                                            0x81, 0x02, 0x95, 0x40, 0x09, 0x03, 0x91, 0x02, 0xC0};

struct Stylus {
    uint32_t seq, echo;  // of the report sent last, of the force taken last
    uint32_t sent;       // reports
    uint32_t forces;     // taken
    uint32_t bad, wrong_length, gaps;
    float force_n[3], most_n;
    int unplugged;
};

static uint16_t crc16(const uint8_t* bytes, int count) {
    uint16_t crc = 0xFFFF;
    for (int i = 0; i < count; ++i) {
        crc = (uint16_t)(crc ^ (bytes[i] << 8));
        for (int bit = 0; bit < 8; ++bit) crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
    }
    return crc;
}

// A report from the host, without its id.
static void take_force(struct Stylus* stylus, const uint8_t* report, int bytes) {
    uint16_t crc;
    uint32_t seq;
    if (bytes != kReportBytes) {
        ++stylus->wrong_length;
        return;
    }
    memcpy(&crc, report + 62, 2);
    if (crc != crc16(report, 62)) {
        ++stylus->bad;
        return;
    }
    memcpy(&seq, report, 4);
    memcpy(stylus->force_n, report + 4, 12);
    if (stylus->forces > 0 && seq != stylus->echo + 1) ++stylus->gaps;
    stylus->echo = seq;
    ++stylus->forces;
    for (int i = 0; i < 3; ++i) stylus->most_n = fmaxf(stylus->most_n, fabsf(stylus->force_n[i]));
}

// The next report to the host, one per millisecond: in the air, down into the plate within a tenth of a second, then
// half a millimetre in.
static void next_report(struct Stylus* stylus, uint8_t report[kReportBytes]) {
    const uint32_t ms = stylus->sent++;
    const float z = ms < 500 ? 1.0f : ms < 600 ? 1.0f - 0.015f * (float)(ms - 500) : -0.5f;
    const float position_mm[3] = {0.3f, 0.0f, z};
    const uint16_t calibrated = 1 << 4;
    const uint32_t t_us = 1000u * ms;
    ++stylus->seq;
    memset(report, 0, kReportBytes);
    memcpy(report, &stylus->seq, 4);
    memcpy(report + 4, &t_us, 4);
    memcpy(report + 8, position_mm, 12);
    memcpy(report + 34, &calibrated, 2);
    memcpy(report + 36, &stylus->echo, 4);
}

static void print_stylus(const struct Stylus* stylus, const char* more) {
    printf("DEVICE sent=%u forces=%u bad=%u wrong_length=%u gaps=%u most_n=%.3f last_n=%.3f unplugged=%d%s\n",
           stylus->sent, stylus->forces, stylus->bad, stylus->wrong_length, stylus->gaps, (double)stylus->most_n,
           (double)fabsf(stylus->force_n[2]), stylus->unplugged, more);
}
