// The commands of hapticlod-station, one file each. They return the exit status.
#pragma once
#include <span>
#include <string_view>

#include "io/result.hpp"

namespace hapticlod::station {

inline constexpr int kExitFine = 0;
inline constexpr int kExitFault = 1;     // the run ended in SAFE
inline constexpr int kExitBadInput = 2;  // one line on stderr said what and what to do

using Words = std::span<const std::string_view>;

int command_run(Words words);
int command_replay(Words words);
int command_inspect(Words words);
int command_devices(Words words);
int command_status(Words words);
int command_doctor(Words words);
int command_qualify(Words words);
int command_calibrate(Words words);
int command_verify(Words words);

// Prints the fault's line to stderr; returns kExitBadInput.
int refuse(const Fault& fault);

}  // namespace hapticlod::station
