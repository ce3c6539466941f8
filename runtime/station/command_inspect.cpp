// inspect: what a bundle holds, after checking all of it.
#include <cstdio>

#include "io/bundle.hpp"
#include "io/digest.hpp"
#include "io/json_text.hpp"
#include "station/arguments.hpp"
#include "station/commands.hpp"

namespace hapticlod::station {
namespace {

void write_sections(JsonWriter& json, const Bundle& bundle) {
    json.key("sections").open('[');
    for (const Section& section : bundle.sections()) {
        json.open('{')
            .field("type", section.entry.type)
            .field("name", section_name(section.entry.type))
            .field("version", section.entry.version)
            .field("level", section.entry.level)
            .field("optional", (section.entry.flags & kSectionOptional) != 0)
            .field("read", section.known())
            .field("offset", section.entry.offset)
            .field("length", section.entry.length)
            .field("blake2b_256", std::string_view(hex(section.entry.digest)))
            .close();
    }
    json.close();
}

void write_config(JsonWriter& json, const ConfigData& config) {
    const auto list = [&json](const char* name, const auto* values, std::uint32_t count) {
        json.key(name).open('[');
        for (std::uint32_t i = 0; i < count; ++i) json.value(values[i]);
        json.close();
    };
    json.key("config").open('{');
    json.field("mapping", config.mapping == 0 ? "paper" : "two-sided");
    json.field("policy", config.policy == 0 ? "velocity" : "distance");
    json.field("shading", config.shading != 0);
    list("origin_mm", config.origin_mm, 3);
    json.field("loop_hz", config.loop_hz).field("budget_us", config.budget_us);
    json.field("stiffness_n_mm", config.stiffness_n_mm).field("damping_n_s_mm", config.damping_n_s_mm);
    json.field("friction_static", config.friction_static).field("friction_dynamic", config.friction_dynamic);
    json.field("filter_hz", config.filter_hz).field("hysteresis", config.hysteresis).field("dwell_s", config.dwell_s);
    json.field("l_in_mm", config.l_in_mm).field("l_out_mm", config.l_out_mm);
    json.field("closest_bound_mm", config.closest_bound_mm).field("blend_s", config.blend_s);
    json.field("max_force_n", config.max_force_n).field("max_slew_n_s", config.max_slew_n_s);
    json.field("engage_s", config.engage_s).field("crack_mm", config.crack_mm);
    list("speeds_mm_s", config.speeds_mm_s, config.level_count - 1);
    json.close();
}

// Of a scene: its parts with their levels, and what the scene shows at each of its own.
void write_parts(JsonWriter& json, const Bundle& bundle) {
    const ConfigData& config = bundle.config();
    json.key("scene_triangles").open('[');
    for (std::uint32_t i = 0; i < config.level_count; ++i) json.value(config.triangles[i]);
    json.close();
    json.key("parts").open('[');
    std::size_t stored = 0;
    for (const PartData& part : bundle.parts()) {
        json.open('{').field("name", part.name).field("hidden", (part.flags & kPartHidden) != 0);
        json.key("position_mm").open('[');
        for (const double v : part.position_mm) json.value(v);
        json.close();
        json.key("orientation").open('[');
        for (const double v : part.orientation) json.value(v);
        json.close();
        json.key("levels").open('[');
        for (std::uint32_t k = 0; k < part.level_count; ++k, ++stored) {
            const LevelView& level = bundle.levels()[stored];
            json.open('{')
                .field("triangles", level.triangle_count())
                .field("vertices", level.vertex_count())
                .field("cell_mm", level.hash->cell_mm)
                .field("bytes", std::uint64_t{level.bytes()})
                .field("materials", !level.materials.empty())
                .field("rebuilt", bundle.rebuilt(stored))
                .close();
        }
        json.close().close();
    }
    json.close();
}

std::string as_json(const Bundle& bundle) {
    JsonWriter json;
    json.open('{');
    json.field("path", std::string_view(bundle.path())).field("format", kBundleVersion);
    json.field("bytes", std::uint64_t{bundle.file_bytes()});
    const std::string signer = bundle.signer() ? base64(*bundle.signer()) : "";
    json.field("signer", std::string_view(signer));
    write_config(json, bundle.config());
    json.key("levels").open('[');
    for (std::uint32_t i = 0; bundle.parts().empty() && i < bundle.config().level_count; ++i) {
        const LevelView& level = bundle.levels()[i];
        json.open('{')
            .field("triangles", level.triangle_count())
            .field("vertices", level.vertex_count())
            .field("cell_mm", level.hash->cell_mm)
            .field("balls", bundle.config().balls[i])
            .field("bytes", std::uint64_t{level.bytes()})
            .field("materials", !level.materials.empty())
            .field("rebuilt", bundle.rebuilt(i))
            .close();
    }
    json.close();
    if (!bundle.parts().empty()) write_parts(json, bundle);
    json.field("tool_balls", std::uint64_t{bundle.tool().size()});
    json.field("golden_ticks", std::uint64_t{bundle.golden_record().size()});
    write_sections(json, bundle);
    json.key("manifest").raw(bundle.manifest());
    return json.close().text();
}

void print_parts(const Bundle& bundle) {
    const ConfigData& config = bundle.config();
    std::size_t stored = 0;
    for (const PartData& part : bundle.parts()) {
        std::printf("  part %s%s:", part.name, (part.flags & kPartHidden) != 0 ? " (hidden at first)" : "");
        for (std::uint32_t k = 0; k < part.level_count; ++k, ++stored) {
            const LevelView& level = bundle.levels()[stored];
            std::printf("%s %u triangles, %.1f MB%s%s", k == 0 ? "" : ";", level.triangle_count(),
                        static_cast<double>(level.bytes()) * 1e-6, bundle.rebuilt(stored) ? " (rebuilt here)" : "",
                        level.materials.empty() ? "" : ", with materials");
        }
        std::printf("\n");
    }
    for (std::uint32_t i = 0; i < config.level_count && !bundle.parts().empty(); ++i) {
        std::printf("  level %u: %u triangles of all parts, %u of %zu balls", i, config.triangles[i], config.balls[i],
                    bundle.tool().size());
        if (i + 1 < config.level_count) std::printf(", up to %.3g mm/s", config.speeds_mm_s[i]);
        std::printf("\n");
    }
}

void print_text(const Bundle& bundle) {
    const ConfigData& config = bundle.config();
    std::printf("%s: bundle format %u, %.1f MB, %zu sections, all checked\n", bundle.path().c_str(), kBundleVersion,
                static_cast<double>(bundle.file_bytes()) * 1e-6, bundle.sections().size());
    std::printf("  %s%s\n", bundle.signer() ? "signed with ed25519 " : "not signed",
                bundle.signer() ? base64(*bundle.signer()).c_str() : "");
    std::printf("  loop %g Hz, budget %g us, stiffness %g N/mm, force at most %g N\n", config.loop_hz, config.budget_us,
                config.stiffness_n_mm, config.max_force_n);
    print_parts(bundle);
    for (std::uint32_t i = 0; i < config.level_count && bundle.parts().empty(); ++i) {
        const LevelView& level = bundle.levels()[i];
        std::printf("  level %u: %u triangles, cell %.3g mm, %u of %zu balls, %.1f MB%s%s", i, level.triangle_count(),
                    level.hash->cell_mm, config.balls[i], bundle.tool().size(),
                    static_cast<double>(level.bytes()) * 1e-6, bundle.rebuilt(i) ? " (rebuilt here)" : "",
                    level.materials.empty() ? "" : ", with materials");
        if (i + 1 < config.level_count) std::printf(", up to %.3g mm/s", config.speeds_mm_s[i]);
        std::printf("\n");
    }
    std::printf("  mapping %s, L in %.3g mm, L out %.3g mm, blend %.3g ms, filter %.3g Hz, hysteresis %.3g\n",
                config.mapping == 0 ? "paper" : "two-sided", config.l_in_mm, config.l_out_mm, config.blend_s * 1e3,
                config.filter_hz, config.hysteresis);
    std::printf("  golden motion: %zu ticks\n", bundle.golden_motion().size());
    for (const Section& section : bundle.sections()) {
        if (!section.known()) {
            std::printf("  %s, version %u: not known here, skipped\n", section.name().c_str(), section.entry.version);
        }
    }
}

}  // namespace

int command_inspect(Words words) {
    const auto arguments = Arguments::parse(words, {{"BUNDLE"}, {}, {"--json"}});
    if (!arguments) return refuse(arguments.fault());
    const auto bundle = Bundle::open(arguments.value().positional(0));
    if (!bundle) return refuse(bundle.fault());
    if (arguments.value().flag("--json")) {
        std::puts(as_json(bundle.value()).c_str());
    } else {
        print_text(bundle.value());
    }
    return kExitFine;
}

}  // namespace hapticlod::station
