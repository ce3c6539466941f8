#include "station/profile_folder.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>

namespace hapticlod::station {
namespace {

namespace fs = std::filesystem;

std::vector<fs::path> files_in(const fs::path& folder) {
    std::vector<fs::path> files;
    std::error_code error;
    for (const fs::directory_entry& entry : fs::directory_iterator(folder, error)) {
        if (entry.path().extension() == ".toml") files.push_back(entry.path());
    }
    std::sort(files.begin(), files.end());
    return files;
}

DeviceProfile simulator() {
    DeviceProfile profile;
    profile.file = profile.name = "sim";
    profile.simulated = SimulatedBody{};
    return profile;
}

}  // namespace

std::vector<std::string> profile_folders() {
    std::vector<std::string> folders;
    if (const char* chosen = std::getenv("HAPTICLOD_DEVICES"); chosen != nullptr && *chosen != '\0') {
        folders.emplace_back(chosen);
    }
    std::error_code error;
    const fs::path bin = fs::read_symlink("/proc/self/exe", error).parent_path();
    // A deployed release, a source tree (build/release/hapticlod-station), a wheel in an environment, and a plain
    // installation.
    folders.push_back((bin / "devices").lexically_normal());
    folders.push_back((bin / "../../configs/devices").lexically_normal());
    for (const fs::directory_entry& lib : fs::directory_iterator(bin / "../lib", error)) {
        if (lib.path().filename().string().starts_with("python3")) {
            folders.push_back((lib.path() / "site-packages/hapticlod/configs/devices").lexically_normal());
        }
    }
    folders.push_back((bin / "../share/hapticlod/devices").lexically_normal());
    return folders;
}

Result<DeviceProfile> find_profile(const std::string& name) {
    if (name == "sim") return simulator();
    if (name.find('/') != std::string::npos || name.ends_with(".toml")) return read_device_profile(name);
    std::string known = "sim";
    for (const std::string& folder : profile_folders()) {
        for (const fs::path& file : files_in(folder)) {
            if (file.stem() == name) return read_device_profile(file);
            known += ", " + file.stem().string();
        }
    }
    return Fault{"--device", "'" + name + "' is not known", "give one of " + known + ", or a profile's TOML file"};
}

std::vector<Result<DeviceProfile>> all_profiles() {
    std::vector<Result<DeviceProfile>> profiles;
    for (const std::string& folder : profile_folders()) {
        for (const fs::path& file : files_in(folder)) profiles.push_back(read_device_profile(file));
    }
    return profiles;
}

}  // namespace hapticlod::station
