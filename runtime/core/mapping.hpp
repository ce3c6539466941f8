// Carrying the contact from one level to the next (Zhou et al. 2009, section 2.3), and its two-sided successor.
#pragma once
#include <span>
#include <vector>

#include "core/contact.hpp"

namespace hapticlod {

// What is known of the contact on the level that is being left.
struct ContactMemory {
    Vec3 normal;  // direction of the last force
    Vec3 point;   // contact point on the surface
    std::uint32_t ball = 0;
    double side = 1.0;  // +1: touched from the front of its triangle, -1: from behind
};

struct Interval {
    double from, to;
    bool facing;
};

class Mapper {
public:
    void allocate() {
        intervals_.resize(Candidates::kMaxBlocks * 8);
        crossings_.resize(kMaxCrossings);
    }
    static constexpr std::size_t bytes() {
        return Candidates::kMaxBlocks * 8 * sizeof(Interval) + kMaxCrossings * sizeof(Crossing);
    }

    // Moves the solver's reference point onto the bound level. Nearest touch on [SCP - l_in n, SCP + l_out n], the
    // tool swept along it; otherwise the closest point within bound_mm; otherwise a miss (the point is left alone).
    MappingOutcome two_sided(ContactSolver& solver, const ContactMemory& memory, double l_in_mm, double l_out_mm,
                             double bound_mm, std::span<const SolverBall> balls, TickCounters& counters);

    // The first half of that. sided: balls that a line carries wholly behind the surface are behind it, though they
    // touch nothing.
    bool rest_on_line(ContactSolver& solver, const ContactMemory& memory, double l_in_mm, double l_out_mm, bool sided,
                      std::span<const SolverBall> balls, TickCounters& counters);

    // The paper's rule: one-sided [P, P + l n] from the contact point, all voxels of the box of the two corner voxels,
    // the nearest intersection becomes the contact point; on a miss the SCP stays and contact detection decides.
    static MappingOutcome paper(ContactSolver& solver, const ContactMemory& memory, double length_mm,
                                TickCounters& counters);

private:
    static constexpr std::size_t kMaxCrossings = 1024;
    struct Crossing {
        double at;
        std::uint32_t ball;
        bool facing;
    };

    std::vector<Interval> intervals_;
    std::vector<Crossing> crossings_;
};

}  // namespace hapticlod
