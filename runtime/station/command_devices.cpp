// devices: what the system lists, and which profile is for it.
#include <cstdio>

#include "io/json_text.hpp"
#include "station/arguments.hpp"
#include "station/commands.hpp"
#include "station/hid_connection.hpp"
#include "station/profile_folder.hpp"

namespace hapticlod::station {
namespace {

std::string hex4(unsigned value) {
    char text[8];
    std::snprintf(text, sizeof(text), "%04x", value);
    return text;
}

std::vector<std::string> profiles_for(const HidEntry& entry, const std::vector<Result<DeviceProfile>>& profiles) {
    std::vector<std::string> names;
    for (const Result<DeviceProfile>& profile : profiles) {
        if (!profile || profile.value().simulated || !matches(entry, profile.value().match)) continue;
        names.push_back(profile.value().file);
    }
    return names;
}

}  // namespace

int command_devices(Words words) {
    const auto arguments = Arguments::parse(words, {{}, {"--profile"}, {"--json"}});
    if (!arguments) return refuse(arguments.fault());
    auto profiles = all_profiles();
    if (const auto file = arguments.value().option("--profile")) {
        auto profile = read_device_profile(*file);
        if (!profile) return refuse(profile.fault());
        profiles.clear();
        profiles.push_back(std::move(profile));
    }
    for (const auto& profile : profiles) {
        if (!profile) std::fprintf(stderr, "%s\n", profile.fault().line().c_str());
    }
    const std::vector<HidEntry> entries = list_hid();
    if (arguments.value().flag("--json")) {
        JsonWriter json;
        json.open('[');
        for (const HidEntry& entry : entries) {
            json.open('{').field("path", std::string_view(entry.path));
            json.field("vendor_id", std::uint32_t{entry.vendor_id})
                .field("product_id", std::uint32_t{entry.product_id});
            json.field("usage_page", std::uint32_t{entry.usage_page}).field("usage", std::uint32_t{entry.usage});
            json.field("manufacturer", std::string_view(entry.manufacturer));
            json.field("product", std::string_view(entry.product)).field("serial", std::string_view(entry.serial));
            json.key("profiles").open('[');
            for (const std::string& name : profiles_for(entry, profiles)) json.value(std::string_view(name));
            json.close().close();
        }
        std::puts(json.close().text().c_str());
        return kExitFine;
    }
    if (arguments.value().option("--profile")) {
        const DeviceProfile& checked = profiles.front().value();
        std::printf("%s: no fault in this profile (%s)\n", checked.file.c_str(), checked.name.c_str());
    }
    if (entries.empty()) {
        std::puts("no HID device is there; sim, the simulated one, always is");
        return kExitFine;
    }
    for (const HidEntry& entry : entries) {
        std::printf("%s  %s:%s  usage %s/%s  %s %s  serial %s\n", entry.path.c_str(), hex4(entry.vendor_id).c_str(),
                    hex4(entry.product_id).c_str(), hex4(entry.usage_page).c_str(), hex4(entry.usage).c_str(),
                    entry.manufacturer.c_str(), entry.product.c_str(),
                    entry.serial.empty() ? "none" : entry.serial.c_str());
        for (const std::string& name : profiles_for(entry, profiles)) std::printf("    %s\n", name.c_str());
    }
    return kExitFine;
}

}  // namespace hapticlod::station
