// Which balls of a tool are side by side: a tree over its first P balls whose worst gap is as small as can be. No
// surface runs between the centres of two balls of empty space that overlap, so one side known is many sides known.
#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "core/tool_tree.hpp"

namespace hapticlod {

struct ToolLink {
    std::uint32_t ball, to;  // every ball but the root is linked to one that comes before it
};

class ToolLinks {
public:
    // A tree for each of these counts of first balls: what the levels use.
    void build(std::span<const Vec3> centres, std::span<const SolverBall> balls, std::span<const std::uint32_t> counts);

    // Of the first `count` balls, none where no tree was built for so many.
    [[nodiscard]] std::span<const ToolLink> of(std::size_t count) const;

private:
    std::vector<std::vector<ToolLink>> trees_;
};

}  // namespace hapticlod
