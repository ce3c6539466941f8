// doctor: what on this machine stands in a loop's way.
#include <algorithm>
#include <cstdio>

#include "io/json_text.hpp"
#include "station/arguments.hpp"
#include "station/commands.hpp"
#include "station/doctor.hpp"

namespace hapticlod::station {

int command_doctor(Words words) {
    const auto arguments = Arguments::parse(words, {{}, {}, {"--json"}});
    if (!arguments) return refuse(arguments.fault());
    constexpr const char* kNames[] = {"good", "weak", "bad"};
    const std::vector<Finding> findings = diagnose("");
    const bool bad = std::any_of(findings.begin(), findings.end(),
                                 [](const Finding& finding) { return finding.health == Health::bad; });
    JsonWriter json;
    json.open('[');
    for (const Finding& finding : findings) {
        const char* health = kNames[static_cast<int>(finding.health)];
        json.open('{').field("what", std::string_view(finding.what)).field("health", health);
        json.field("found", std::string_view(finding.found)).field("remedy", std::string_view(finding.remedy)).close();
        if (arguments.value().flag("--json")) continue;
        std::printf("%-4s  %-22s %s\n", health, finding.what.c_str(), finding.found.c_str());
        if (!finding.remedy.empty()) std::printf("      %-22s -> %s\n", "", finding.remedy.c_str());
    }
    if (arguments.value().flag("--json")) std::puts(json.close().text().c_str());
    return bad ? kExitFault : kExitFine;
}

}  // namespace hapticlod::station
