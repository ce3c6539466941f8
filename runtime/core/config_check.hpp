// Range checks of a configuration that comes from outside. Empty string: usable.
#pragma once
#include <string>

#include "core/layout.hpp"

namespace hapticlod {

[[nodiscard]] std::string check_config(const ConfigData& config);

}  // namespace hapticlod
