# Toolchain file for `make station-static CROSS=aarch64-linux-gnu` (Debian: g++-aarch64-linux-gnu, libsodium-dev:arm64).
set(CMAKE_TRY_COMPILE_PLATFORM_VARIABLES HAPTICLOD_CROSS)
string(REGEX MATCH "^[^-]+" CMAKE_SYSTEM_PROCESSOR "${HAPTICLOD_CROSS}")
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_C_COMPILER "${HAPTICLOD_CROSS}-gcc")
set(CMAKE_CXX_COMPILER "${HAPTICLOD_CROSS}-g++")
set(CMAKE_LIBRARY_ARCHITECTURE "${HAPTICLOD_CROSS}")
