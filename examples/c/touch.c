/* Presses the bundle's tool down on the middle of the scan, 0.1 m/s, and prints the largest force. */
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
    double most_n = 0.0;
    for (int tick = 0; tick <= 100; ++tick) { /* your loop: read the device, call hlod_tick, send record.force_n */
        const double time_s = tick / info.loop_hz;
        const double hip_mm[3] = {info.origin_mm[0], info.origin_mm[1], info.origin_mm[2] + 5.0 - 100.0 * time_s};
        hlod_record record;
        hlod_tick(renderer, time_s, hip_mm, NULL, &record);
        most_n = fmax(most_n, sqrt(pow(record.force_n[0], 2) + pow(record.force_n[1], 2) + pow(record.force_n[2], 2)));
    }
    printf("%.6f\n", most_n);
    hlod_renderer_destroy(renderer);
    hlod_bundle_close(bundle);
    return 0;
}
