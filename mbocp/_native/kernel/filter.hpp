// Filter acceptance of trial steps, [Waechter2006]: progress in feasibility or cost, and no way back.
#pragma once

#include <limits>
#include <vector>

#include "results.hpp"

namespace mbocp {

// Whether a trial is accepted, and whether for the decrease of its cost; else the filter grows.
struct Verdict {
    bool is_accepted = false, by_cost = false;
};

class Filter {
public:
    Filter() = default;
    // For a first iterate of the given violation. Without limits later ones may violate much more, for equations alone
    // lead back in a few steps; steps that a barrier keeps short do not.
    static Filter start(double violation, bool is_limited);

    // `slope`: directional derivative of the objective, the cost with limits and their barrier.
    Verdict accepts(const Trial& before, const Trial& trial, double slope, double length) const;
    // Whether relaxed steps made progress: closer to feasible than where they began.
    bool accepts_after_relaxation(const Trial& reference, const Trial& trial) const;

    // Also forbids going back to `before`.
    Filter with_corner(const Trial& before) const;
    // For another objective: with the same bounds of the violation, and no corners.
    Filter without_corners() const;

    double most_violation() const { return most_violation_; }
    int num_corners() const { return static_cast<int>(corners_.size()); }

private:
    struct Corner {
        double violation, objective;
    };
    bool forbids(const Trial& trial) const;
    bool must_descend(double violation, double slope, double length) const;

    std::vector<Corner> corners_;  // no later iterate may be worse than one of them in both
    double most_violation_ = std::numeric_limits<double>::infinity();  // of any iterate
    double least_violation_ = 0.0;  // below it a descent direction of the cost has to decrease the cost
};

}  // namespace mbocp
