// The C ABI over Bundle and Renderer. hapticlod.h is the manual. No exception leaves a function here.
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstring>
#include <memory>
#include <new>
#include <string>

#include "core/config_check.hpp"
#include "core/renderer.hpp"
#include "hapticlod/hapticlod.h"
#include "io/bundle.hpp"
#include "io/trust.hpp"

using hapticlod::Bundle;
using hapticlod::Renderer;
using hapticlod::TickRecord;

// hlod_record and TickRecord are one layout under two names.
static_assert(sizeof(hlod_record) == sizeof(TickRecord));
static_assert(offsetof(hlod_record, torque_n_mm) == offsetof(TickRecord, torque_n_mm));
static_assert(offsetof(hlod_record, speed_mm_s) == offsetof(TickRecord, speed_mm_s));
static_assert(offsetof(hlod_record, level) == offsetof(TickRecord, level));
static_assert(offsetof(hlod_record, errors) == offsetof(TickRecord, errors));
static_assert(offsetof(hlod_record, mapping_cells) == offsetof(TickRecord, mapping_cells));
static_assert(HLOD_MAX_LEVELS == hapticlod::kMaxLevels);
static_assert(int{HLOD_ERR_START_INSIDE} == int{hapticlod::kErrStartInside});
static_assert(int{HLOD_ERR_TURN_HELD} == int{hapticlod::kErrTurnHeld});
static_assert(int{HLOD_ERR_HIP_JUMP} == int{hapticlod::kErrHipJump});

struct hlod_bundle {
    std::shared_ptr<const Bundle> content;
    std::string manifest;  // terminated, which the mapped text is not
};

struct hlod_renderer {
    std::shared_ptr<const Bundle> content;  // levels live there
    Renderer renderer;
};

namespace {

void say(char* message, std::size_t message_bytes, const std::string& text) {
    if (message == nullptr || message_bytes == 0) return;
    const std::size_t length = std::min(text.size(), message_bytes - 1);
    std::memcpy(message, text.data(), length);
    message[length] = '\0';
}

// Runs what may throw; the message of a failure never allocates.
template <class Work>
hlod_status guarded(char* message, std::size_t message_bytes, Work&& work) noexcept {
    if (message != nullptr && message_bytes > 0) message[0] = '\0';
    const auto failed = [&](const char* text, hlod_status status) {
        if (message != nullptr && message_bytes > 0) {
            std::strncpy(message, text, message_bytes - 1);
            message[message_bytes - 1] = '\0';
        }
        return status;
    };
    try {
        return work();
    } catch (const std::bad_alloc&) {
        return failed("memory: is exhausted; free some or use a smaller bundle", HLOD_NO_MEMORY);
    } catch (...) {
        return failed("hapticlod: internal error; report it", HLOD_INTERNAL);
    }
}

hlod_status handed_over(hapticlod::Result<Bundle> opened, hlod_bundle** bundle, char* message,
                        std::size_t message_bytes) {
    if (!opened) {
        say(message, message_bytes, opened.fault().line());
        return HLOD_BAD_BUNDLE;
    }
    auto content = std::make_shared<const Bundle>(std::move(opened).value());
    auto manifest = std::string(content->manifest());
    *bundle = new hlod_bundle{std::move(content), std::move(manifest)};
    return HLOD_OK;
}

}  // namespace

extern "C" {

uint32_t hlod_abi_version(void) noexcept { return HLOD_ABI_VERSION; }

hlod_status hlod_bundle_open(const char* path, hlod_bundle** bundle, char* message, size_t message_bytes) noexcept {
    if (bundle == nullptr) return HLOD_BAD_ARGUMENT;
    *bundle = nullptr;
    if (path == nullptr) return HLOD_BAD_ARGUMENT;
    return guarded(message, message_bytes,
                   [&] { return handed_over(Bundle::open(path), bundle, message, message_bytes); });
}

hlod_status hlod_bundle_open_known(const char* path, const char* record_path, hlod_bundle** bundle, char* message,
                                   size_t message_bytes) noexcept {
    if (bundle == nullptr) return HLOD_BAD_ARGUMENT;
    *bundle = nullptr;
    if (path == nullptr) return HLOD_BAD_ARGUMENT;
    return guarded(message, message_bytes, [&] {
        hapticlod::CheckedFiles known(record_path == nullptr ? hapticlod::CheckedFiles::standard_path() : record_path);
        return handed_over(Bundle::open(path, known), bundle, message, message_bytes);
    });
}

hlod_status hlod_bundle_open_memory(const void* data, size_t bytes, const char* name, hlod_bundle** bundle,
                                    char* message, size_t message_bytes) noexcept {
    if (bundle == nullptr) return HLOD_BAD_ARGUMENT;
    *bundle = nullptr;
    if (data == nullptr) return HLOD_BAD_ARGUMENT;
    return guarded(message, message_bytes, [&] {
        const std::span<const std::byte> content(static_cast<const std::byte*>(data), bytes);
        return handed_over(Bundle::open(content, name == nullptr ? "memory" : name), bundle, message, message_bytes);
    });
}

void hlod_bundle_close(hlod_bundle* bundle) noexcept { delete bundle; }

hlod_status hlod_bundle_info(const hlod_bundle* bundle, hlod_info* info) noexcept {
    if (bundle == nullptr || info == nullptr || info->struct_bytes != sizeof(hlod_info)) return HLOD_BAD_ARGUMENT;
    const Bundle& content = *bundle->content;
    const hapticlod::ConfigData& config = content.config();
    *info = {};
    info->struct_bytes = sizeof(hlod_info);
    info->level_count = config.level_count;
    info->ball_count = static_cast<uint32_t>(content.tool().size());
    info->loop_hz = config.loop_hz;
    info->budget_us = config.budget_us;
    info->stiffness_n_mm = config.stiffness_n_mm;
    info->max_force_n = config.max_force_n;
    std::copy_n(config.origin_mm, 3, info->origin_mm);
    for (uint32_t level = 0; level < config.level_count; ++level) {
        info->triangles[level] = config.triangles[level];
        info->speeds_mm_s[level] = level + 1 < config.level_count ? config.speeds_mm_s[level] : 0.0;
    }
    info->golden_ticks = content.golden_record().size();
    return HLOD_OK;
}

hlod_status hlod_bundle_trusted(const hlod_bundle* bundle, const char* trusted_keys_path, char* message,
                                size_t message_bytes) noexcept {
    if (bundle == nullptr) return HLOD_BAD_ARGUMENT;
    return guarded(message, message_bytes, [&] {
        const auto verdict = hapticlod::trust_of(
            bundle->content->signer(),
            trusted_keys_path == nullptr ? std::nullopt : std::optional<std::string>(trusted_keys_path));
        say(message, message_bytes,
            verdict ? bundle->content->path() + ": is " + verdict.value().text() : verdict.fault().line());
        if (!verdict) return HLOD_BAD_ARGUMENT;
        return verdict.value().trust == hapticlod::Trust::trusted ? HLOD_OK : HLOD_UNTRUSTED;
    });
}

const char* hlod_bundle_manifest(const hlod_bundle* bundle) noexcept {
    return bundle == nullptr ? nullptr : bundle->manifest.c_str();
}

hlod_status hlod_bundle_golden(const hlod_bundle* bundle, uint64_t tick, double* time_s, double position_mm[3],
                               double orientation_wxyz[4], hlod_record* record) noexcept {
    if (bundle == nullptr || tick >= bundle->content->golden_record().size()) return HLOD_BAD_ARGUMENT;
    const hapticlod::MotionRow& row = bundle->content->golden_motion()[tick];
    if (time_s != nullptr) *time_s = row.time_s;
    if (position_mm != nullptr) std::copy_n(row.position_mm, 3, position_mm);
    if (orientation_wxyz != nullptr) std::copy_n(row.orientation, 4, orientation_wxyz);
    if (record != nullptr) std::memcpy(record, &bundle->content->golden_record()[tick], sizeof(hlod_record));
    return HLOD_OK;
}

hlod_status hlod_renderer_create(const hlod_bundle* bundle, const hlod_options* options, hlod_renderer** renderer,
                                 char* message, size_t message_bytes) noexcept {
    if (renderer == nullptr) return HLOD_BAD_ARGUMENT;
    *renderer = nullptr;
    if (bundle == nullptr || (options != nullptr && options->struct_bytes != sizeof(hlod_options))) {
        return HLOD_BAD_ARGUMENT;
    }
    return guarded(message, message_bytes, [&] {
        hapticlod::ConfigData config = bundle->content->config();
        if (options != nullptr) {
            if (options->stiffness_n_mm != 0.0) config.stiffness_n_mm = options->stiffness_n_mm;
            // Written so that NaN is passed on and refused below, not dropped.
            if (options->max_force_n != 0.0 && !(options->max_force_n > config.max_force_n)) {
                config.max_force_n = options->max_force_n;
            }
            if (options->loop_hz != 0.0) config.loop_hz = options->loop_hz;
        }
        if (const std::string reason = hapticlod::check_config(config); !reason.empty()) {
            say(message, message_bytes, "hlod_options: " + reason + "; correct the option");
            return HLOD_BAD_OPTION;
        }
        auto made = std::make_unique<hlod_renderer>();
        made->content = bundle->content;
        if (const std::string reason = made->content->prepare(made->renderer, config); !reason.empty()) {
            say(message, message_bytes, bundle->content->path() + ": " + reason + "; write the bundle again");
            return HLOD_BAD_BUNDLE;
        }
        *renderer = made.release();
        return HLOD_OK;
    });
}

void hlod_renderer_destroy(hlod_renderer* renderer) noexcept { delete renderer; }

hlod_status hlod_tick(hlod_renderer* renderer, double time_s, const double position_mm[3],
                      const double orientation_wxyz[4], hlod_record* record) noexcept {
    if (renderer == nullptr || position_mm == nullptr || record == nullptr) return HLOD_BAD_ARGUMENT;
    hapticlod::Pose pose{{position_mm[0], position_mm[1], position_mm[2]}};
    if (orientation_wxyz != nullptr) std::copy_n(orientation_wxyz, 4, pose.orientation);
    TickRecord row;
    renderer->renderer.tick(pose, time_s, row);
    std::memcpy(record, &row, sizeof(row));
    return HLOD_OK;
}

void hlod_reset(hlod_renderer* renderer) noexcept {
    if (renderer != nullptr) renderer->renderer.reset();
}

void hlod_set_coarsest_floor(hlod_renderer* renderer, uint32_t level) noexcept {
    if (renderer != nullptr) renderer->renderer.set_coarsest_floor(level);
}

}  // extern "C"
