/* Moves the bundle's tool as its golden motion does, a hand that touched the scan, and prints the largest force. */
#include <hapticlod/hapticlod.h>
#include <math.h>
#include <stdio.h>

int main(int count, char** words) {
    hlod_bundle* bundle = NULL;
    hlod_renderer* renderer = NULL;
    hlod_info info = {.struct_bytes = sizeof info};
    char message[256] = "usage: touch BUNDLE TRUSTED_KEYS";
    if (count != 3 || hlod_bundle_open(words[1], &bundle, message, sizeof message) != HLOD_OK ||
        hlod_bundle_trusted(bundle, words[2], message, sizeof message) != HLOD_OK ||
        hlod_bundle_info(bundle, &info) != HLOD_OK ||
        hlod_renderer_create(bundle, NULL, &renderer, message, sizeof message) != HLOD_OK) {
        fprintf(stderr, "%s\n", message);
        hlod_bundle_close(bundle);
        return 2;
    }
    double most_n = 0.0, time_s, hip_mm[3], turned_wxyz[4];
    hlod_record record;
    for (uint64_t tick = 0; tick < info.golden_ticks; ++tick) { /* yours: device, hlod_tick, force */
        hlod_bundle_golden(bundle, tick, &time_s, hip_mm, turned_wxyz, NULL);
        hlod_tick(renderer, time_s, hip_mm, turned_wxyz, &record);
        most_n = fmax(most_n, sqrt(pow(record.force_n[0], 2) + pow(record.force_n[1], 2) + pow(record.force_n[2], 2)));
    }
    printf("%.6f\n", most_n);
    hlod_renderer_destroy(renderer);
    hlod_bundle_close(bundle);
    return 0;
}
