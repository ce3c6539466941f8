// Where device profiles lie, and finding one by its name.
#pragma once
#include <string>
#include <vector>

#include "io/result.hpp"
#include "station/device_profile.hpp"

namespace hapticlod::station {

// The folders that are looked into: $HAPTICLOD_DEVICES, then those of the installation.
[[nodiscard]] std::vector<std::string> profile_folders();
// A path (it has a slash or ends in .toml) or the name of a profile in one of the folders. "sim" is always known.
[[nodiscard]] Result<DeviceProfile> find_profile(const std::string& name);
// Every profile in the folders, by file name; those that cannot be read are faults.
[[nodiscard]] std::vector<Result<DeviceProfile>> all_profiles();

}  // namespace hapticlod::station
