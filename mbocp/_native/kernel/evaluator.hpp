// Values and derivatives at the iterate, and the defects of the optimality conditions.
#pragma once

#include "barrier.hpp"
#include "data.hpp"
#include "step.hpp"

namespace mbocp {

class Evaluator {
public:
    Evaluator(const Problem& problem, const Iterate& iterate, Data& data, Step& step, Barrier& barrier);

    // The Hessian uses multipliers scaled by `share` (0: Gauss-Newton).
    Evaluation evaluate(double share);
    // Another barrier parameter at the iterate of the last evaluation.
    Evaluation weigh(double parameter);
    // Of the barrier's right-hand side alone, see `Barrier::aim`.
    Evaluation aim(double parameter, bool is_curved);

private:
    struct Violations;

    Evaluation finished() const;
    bool evaluate_group(const Group& group, const double* multipliers, int thread);
    void add_up(const Group& group, Violations& violations) const;
    double stationarity(double& largest) const;

    const Problem& problem_;
    const Iterate& iterate_;
    Data& data_;
    Step& step_;
    Barrier& barrier_;
    Evaluation last_;                   // the last evaluation without what depends on the barrier parameter
    Numbers scaled_m_, zeros_, costs_;  // the latter of the stages
    Section section_;
    Groups groups_;
    Scatter scatter_;
};

}  // namespace mbocp
