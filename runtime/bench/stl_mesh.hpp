// Binary or ASCII STL to an indexed mesh, vertices welded where they are equal bit for bit. For benchmarks only:
// real scans are read and repaired by hapticlod.load_scan.
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <vector>

namespace hapticlod::bench {

struct Mesh {
    std::vector<float> vertices;
    std::vector<std::uint32_t> faces;
};

inline std::vector<float> read_corners(const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    if (!in) throw std::runtime_error(path + ": cannot be opened; check the path");
    std::string data((std::istreambuf_iterator<char>(in)), {});
    std::vector<float> corners;
    std::uint32_t count = 0;
    if (data.size() >= 84) std::memcpy(&count, &data[80], 4);
    if (data.size() >= 84 && data.size() == 84 + std::size_t{count} * 50) {
        corners.resize(std::size_t{count} * 9);
        for (std::size_t i = 0; i < count; ++i) std::memcpy(&corners[9 * i], &data[84 + 50 * i + 12], 36);
        return corners;
    }
    std::istringstream text(data);
    for (std::string word; text >> word;) {
        if (word != "vertex") continue;
        float x = 0, y = 0, z = 0;
        if (!(text >> x >> y >> z)) throw std::runtime_error(path + ": a vertex is cut short; export the STL again");
        corners.insert(corners.end(), {x, y, z});
    }
    if (corners.empty() || corners.size() % 9 != 0)
        throw std::runtime_error(path + ": neither a whole binary nor an ASCII STL; export it again");
    return corners;
}

inline Mesh read_stl(const std::string& path) {
    struct Key {
        std::uint32_t bits[3];
        bool operator==(const Key&) const = default;
    };
    struct Hash {
        std::size_t operator()(const Key& k) const {
            return (k.bits[0] * 0x9e3779b97f4a7c15ull ^ k.bits[1] * 0xc2b2ae3d27d4eb4full) ^
                   k.bits[2] * 0x165667b19e3779f9ull;
        }
    };
    const std::vector<float> corners = read_corners(path);
    Mesh mesh;
    mesh.faces.reserve(corners.size() / 3);
    std::unordered_map<Key, std::uint32_t, Hash> seen;
    seen.reserve(corners.size() / 12);
    for (std::size_t i = 0; i < corners.size(); i += 3) {
        float at[3];
        Key key{};
        for (int k = 0; k < 3; ++k) {
            at[k] = corners[i + k] + 0.0f;  // -0 and 0 are one place
            std::memcpy(&key.bits[k], &at[k], 4);
        }
        const auto [slot, fresh] = seen.try_emplace(key, static_cast<std::uint32_t>(mesh.vertices.size() / 3));
        if (fresh) mesh.vertices.insert(mesh.vertices.end(), at, at + 3);
        mesh.faces.push_back(slot->second);
    }
    return mesh;
}

}  // namespace hapticlod::bench
