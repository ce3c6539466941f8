#include "core/tool_tree.hpp"

#include <algorithm>
#include <numeric>

#include "core/morton.hpp"

namespace hapticlod {
namespace {

constexpr std::uint32_t kFanOut = 8;
constexpr double kLeastSizeMm = 1e-30;  // balls nearer together are in one place: a scale of theirs might be infinite

std::uint64_t curve_key(const Vec3& p, const Vec3& lo, double scale) {
    return morton(static_cast<std::int32_t>((p.x - lo.x) * scale), static_cast<std::int32_t>((p.y - lo.y) * scale),
                  static_cast<std::int32_t>((p.z - lo.z) * scale));
}

}  // namespace

void ToolTree::build(std::span<const Vec3> centres, std::span<const SolverBall> balls) {
    nodes_.clear();
    Vec3 lo = centres[0], hi = centres[0];
    for (const Vec3& c : centres) {
        lo = {std::min(lo.x, c.x), std::min(lo.y, c.y), std::min(lo.z, c.z)};
        hi = {std::max(hi.x, c.x), std::max(hi.y, c.y), std::max(hi.z, c.z)};
    }
    const double size = std::max({hi.x - lo.x, hi.y - lo.y, hi.z - lo.z});
    const double scale = size > kLeastSizeMm ? 1023.0 / size : 0.0;
    order_.resize(centres.size());
    std::iota(order_.begin(), order_.end(), 0u);
    std::stable_sort(order_.begin(), order_.end(), [&](std::uint32_t a, std::uint32_t b) {
        return curve_key(centres[a], lo, scale) < curve_key(centres[b], lo, scale);
    });

    const auto enclose = [](Node& node, auto&& for_each) {
        Vec3 sum;
        double n = 0.0;
        for_each([&](const Vec3& c, double) { sum += c, n += 1.0; });
        node.centre = sum * (1.0 / n);
        for_each([&](const Vec3& c, double r) { node.radius = std::max(node.radius, norm(c - node.centre) + r); });
        node.offset = node.centre;
    };
    const auto total = static_cast<std::uint32_t>(order_.size());
    for (std::uint32_t i = 0; i < total; i += kFanOut) {
        Node node{{}, {}, 0.0, i, std::min(kFanOut, total - i), total, true};
        enclose(node, [&](auto&& use) {
            for (std::uint32_t k = i; k < i + node.count; ++k) use(centres[order_[k]], balls[order_[k]].kept);
        });
        for (std::uint32_t k = i; k < i + node.count; ++k) node.least_ball = std::min(node.least_ball, order_[k]);
        nodes_.push_back(node);
    }
    packs_.resize(nodes_.size());
    pack_up(balls);
    for (std::uint32_t from = 0, to = static_cast<std::uint32_t>(nodes_.size()); to - from > 1;) {
        for (std::uint32_t i = from; i < to; i += kFanOut) {
            Node node{{}, {}, 0.0, i, std::min(kFanOut, to - i), total, false};
            enclose(node, [&](auto&& use) {
                for (std::uint32_t k = i; k < i + node.count; ++k) use(nodes_[k].centre, nodes_[k].radius);
            });
            for (std::uint32_t k = i; k < i + node.count; ++k)
                node.least_ball = std::min(node.least_ball, nodes_[k].least_ball);
            nodes_.push_back(node);
        }
        from = to;
        to = static_cast<std::uint32_t>(nodes_.size());
    }
}

void ToolTree::turn(const Rotation& rotation, std::span<const SolverBall> balls) {
    for (Node& node : nodes_) node.offset = rotation * node.centre;
    pack_up(balls);
}

void ToolTree::pack_up(std::span<const SolverBall> balls) {
    for (std::size_t n = 0; n < packs_.size(); ++n) {
        const Node& node = nodes_[n];
        for (std::uint32_t k = 0; k < kFanOut; ++k) {
            const SolverBall& ball = balls[order_[node.first + (k < node.count ? k : 0)]];
            const Vec3 at = ball.offset - node.offset;
            packs_[n].x[k] = static_cast<float>(at.x);
            packs_[n].y[k] = static_cast<float>(at.y);
            packs_[n].z[k] = static_cast<float>(at.z);
            packs_[n].kept[k] = static_cast<float>(ball.kept);
        }
    }
}

}  // namespace hapticlod
