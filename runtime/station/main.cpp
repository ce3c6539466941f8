// hapticlod-station: the program of the machine that the force-feedback device is on.
#include <clocale>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "station/commands.hpp"

namespace hapticlod::station {
namespace {

constexpr const char* kHelp =
    "hapticlod-station: renders a tuned bundle on this machine\n"
    "\n"
    "  run BUNDLE --device NAME [--seconds S] [--cpu N] [--json]\n"
    "      The real-time loop, at the bundle's rate. NAME: sim, a profile's name, or its TOML file (docs/devices.md).\n"
    "      Without --seconds until Ctrl-C; any key, or SIGUSR1, is the emergency stop. The last line printed is JSON;\n"
    "      --json prints nothing else.\n"
    "      sim is a simulated hand and device that follow the bundle's golden motion and feel the force:\n"
    "        --motion CSV           the hand's motion\n"
    "        --virtual-time         simulated time, repeatable and as fast as it computes\n"
    "      a device:\n"
    "        --serial S, --path P   which one, where several match\n"
    "        --centre-mm X,Y,Z      point of the scan that the device's origin stands for; default: the scan's centre\n"
    "        --accept-no-watchdog   run a device whose motors keep their force when this program dies\n"
    "        --reconnect            after it went away: wait for it, and arm it again on Enter\n"
    "      --control PIPE           hide, show and swap parts of a scene while running: see docs/scenes.md\n"
    "      --passivity-damping B    let the passivity controller add up to B N s/mm; else it only observes\n"
    "      --record FILE.mcap       record every tick;  --flight FOLDER  where the last 10 s go after a fault\n"
    "      Bundles must be signed by a key of /etc/hapticlod/trusted_keys or ~/.config/hapticlod/trusted_keys.\n"
    "      --trusted-keys FILE: by one of these. --accept-unsigned: run others too, and mark the report.\n"
    "      What was found right since this machine was started, and not written since, is not read whole again;\n"
    "      --check-all: all of it, all the same.\n"
    "  status [--pid N] [--once] [--json]\n"
    "      What a running station does, from its shared memory.\n"
    "  devices [--profile FILE] [--json]\n"
    "      The HID devices that are there, and the profiles that know them; checks a profile.\n"
    "  doctor [--json]\n"
    "      What on this machine stands in a loop's way, each with its remedy.\n"
    "  calibrate -o STATION.toml [--device NAME] [--rate HZ] [--name TEXT] [--cpu N] [--quick]\n"
    "      Measures this machine for hapticlod tune --station: what work costs, wake-ups, caches. Some 10 s.\n"
    "  qualify BUNDLE [-o CERTIFICATE.json] [--tolerance-n N] [--cpu N] [--json] [--accept-unsigned]\n"
    "      Replays the golden motion here: forces as recorded, p99.9 within the budget? Status 0 passed, 1 failed.\n"
    "  replay BUNDLE MOTION.csv OUT.csv\n"
    "      Renders a motion (t_s,x_mm,y_mm,z_mm[,qw,qx,qy,qz]) offline and writes what every tick gave.\n"
    "  inspect BUNDLE [--json]\n"
    "      Checks a bundle and says what it holds.\n"
    "  verify BUNDLE [--trusted-keys FILE] [--accept-unsigned]\n"
    "      Checks a bundle, and whether this station trusts who signed it.\n"
    "  --help, --version\n"
    "\n"
    "Exit status: 0 fine, 1 the safety core stopped the run, 2 bad input.\n";

struct Command {
    std::string_view name;
    int (*run)(Words);
};
constexpr Command kCommands[] = {
    {"run", command_run},         {"replay", command_replay},       {"inspect", command_inspect},
    {"devices", command_devices}, {"status", command_status},       {"doctor", command_doctor},
    {"qualify", command_qualify}, {"calibrate", command_calibrate}, {"verify", command_verify},
};

}  // namespace
}  // namespace hapticlod::station

int main(int argc, char** argv) {
    using namespace hapticlod::station;
    (void)std::setlocale(LC_CTYPE, "C.UTF-8");  // hidapi turns names of devices into wide characters by it
    const std::vector<std::string_view> words(argv + 1, argv + argc);
    if (words.empty()) {
        std::fputs(kHelp, stderr);
        return kExitBadInput;
    }
    for (const std::string_view word : words) {
        if (word != "--help" && word != "-h") continue;
        std::fputs(kHelp, stdout);
        return kExitFine;
    }
    if (words[0] == "--version") {
        std::puts("hapticlod-station " HAPTICLOD_VERSION);
        return kExitFine;
    }
    try {
        for (const Command& command : kCommands) {
            if (command.name == words[0]) return command.run(Words(words).subspan(1));
        }
    } catch (const std::bad_alloc&) {
        return refuse({"memory", "is exhausted", "close other programs or use a smaller bundle"});
    } catch (const std::exception& error) {
        return refuse({"hapticlod-station", std::string("internal error (") + error.what() + ")", "report it"});
    }
    return refuse({std::string(words[0]), "is no command", "see hapticlod-station --help"});
}
