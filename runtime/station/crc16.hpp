// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected, no final xor. "123456789" gives 0x29B1.
#pragma once
#include <cstddef>
#include <cstdint>

namespace hapticlod::station {

[[nodiscard]] constexpr std::uint16_t crc16_ccitt(const std::uint8_t* bytes, std::size_t count) noexcept {
    std::uint16_t crc = 0xFFFF;
    for (std::size_t i = 0; i < count; ++i) {
        crc = static_cast<std::uint16_t>(crc ^ (bytes[i] << 8));
        for (int bit = 0; bit < 8; ++bit) {
            crc = static_cast<std::uint16_t>((crc & 0x8000) != 0 ? (crc << 1) ^ 0x1021 : crc << 1);
        }
    }
    return crc;
}

}  // namespace hapticlod::station
