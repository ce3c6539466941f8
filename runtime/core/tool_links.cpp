#include "core/tool_links.hpp"

#include <algorithm>
#include <limits>

namespace hapticlod {
namespace {

// Prim 1957: least spanning tree by the gap between balls, which has the least worst gap too.
std::vector<ToolLink> least_tree(std::span<const Vec3> centres, std::span<const SolverBall> balls) {
    std::vector<ToolLink> tree, open;
    for (std::uint32_t b = 1; b < balls.size(); ++b) open.push_back({b, 0});
    std::vector<double> gap(open.size(), std::numeric_limits<double>::infinity());
    for (std::uint32_t last = 0; !open.empty();) {
        std::size_t nearest = 0;
        for (std::size_t i = 0; i < open.size(); ++i) {
            const std::uint32_t b = open[i].ball;
            const double apart = norm(centres[b] - centres[last]) - balls[b].kept - balls[last].kept;
            if (apart < gap[i]) gap[i] = apart, open[i].to = last;
            if (gap[i] < gap[nearest]) nearest = i;
        }
        last = open[nearest].ball;
        tree.push_back(open[nearest]);
        open[nearest] = open.back(), gap[nearest] = gap.back();
        open.pop_back(), gap.pop_back();
    }
    return tree;
}

}  // namespace

void ToolLinks::build(std::span<const Vec3> centres, std::span<const SolverBall> balls,
                      std::span<const std::uint32_t> counts) {
    trees_.clear();
    for (const std::uint32_t count : counts) {
        const std::size_t used = std::min<std::size_t>(count, balls.size());
        if (of(used).empty()) trees_.push_back(least_tree(centres.first(used), balls.first(used)));
    }
}

std::span<const ToolLink> ToolLinks::of(std::size_t count) const {
    for (const std::vector<ToolLink>& tree : trees_)
        if (tree.size() + 1 == count) return tree;
    return {};
}

}  // namespace hapticlod
