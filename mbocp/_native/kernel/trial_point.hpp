// The iterate moved along the direction: cost and violation there, as the line search asks for.
#pragma once

#include "barrier.hpp"
#include "iterate.hpp"

namespace mbocp {

class TrialPoint {
public:
    TrialPoint(const Problem& problem, Iterate& iterate, Barrier& barrier);

    bool move(const Increment& step, double alpha);
    // Moves, and evaluates cost and violation.
    Trial evaluate(const Increment& step, double alpha);
    // The iterate is where it was moved to; multipliers go alpha of their way, those of limits alpha_limits.
    void accept(const Increment& step, double alpha, double alpha_limits);

    const Numbers& c() const { return c_; }  // constraints and end condition at the last `evaluate`
    const Numbers& g() const { return g_; }

private:
    bool evaluate_group(const Group& group, int thread);

    const Problem& problem_;
    Iterate& iterate_;
    Barrier& barrier_;
    Point moved_;
    Numbers c_, g_, costs_;
    Section section_;
    Groups groups_;
};

}  // namespace mbocp
