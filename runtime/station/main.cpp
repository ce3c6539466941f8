// hapticlod-station: the program of the machine that the force-feedback device is on.
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
    "  run BUNDLE --device sim [--seconds S] [--motion CSV] [--cpu N] [--virtual-time] [--json]\n"
    "      The real-time loop, at the bundle's rate. sim: a simulated hand and device that follow the bundle's golden\n"
    "      motion, or the given one, and feel the force. Without --seconds until Ctrl-C. --virtual-time: simulated\n"
    "      time, repeatable and as fast as it computes. The last line printed is JSON; --json prints nothing else.\n"
    "      Bundles must be signed by a key of /etc/hapticlod/trusted_keys or ~/.config/hapticlod/trusted_keys.\n"
    "      --trusted-keys FILE: by one of these. --accept-unsigned: run others too, and mark the report.\n"
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
    {"run", command_run}, {"replay", command_replay}, {"inspect", command_inspect}, {"verify", command_verify}};

}  // namespace

int refuse(const Fault& fault) {
    std::fprintf(stderr, "%s\n", fault.line().c_str());
    return kExitBadInput;
}

}  // namespace hapticlod::station

int main(int argc, char** argv) {
    using namespace hapticlod::station;
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
    return refuse({std::string(words[0]), "is no command", "use run, replay, inspect or verify, or see --help"});
}
