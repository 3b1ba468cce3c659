// The parts of a Newton step that leads towards a minimum: a solve puts them together with all its care, a horizon
// that moves on with less of it.
#pragma once

#include "filter.hpp"
#include "programme.hpp"

namespace mbocp {

// A direction, of which no more is taken than turns a joint by a radian: what the linearisation says of a link that
// turns farther is not worth following.
struct CappedDirection {
    double increment = 0, slope = 0;       // norm over all unknowns; directional derivative of the objective
    double longest = 1, longest_dual = 1;  // part that limits and the cap allow, and limits' multipliers
    double cap = 1;                        // part that the cap alone allows
    double limit = 1;  // of the longest step, what no limit cuts short: beyond it slacks stop at their bounds

    // Where slacks may stop at their bounds, each by itself, limits do not cut the step.
    static CappedDirection of(const Direction& d, bool may_stop);

    // A step length, relative to the longest step, by what no limit cuts short, or 1 beyond that.
    double relative(double length) const { return std::min(1.0, length / limit); }
    // The step length to try after this one: half of it, or what no limit cuts short in between.
    double shorter(double length) const { return 0.5 * length < limit && limit < length ? limit : 0.5 * length; }
};

// Factorisation with the end condition augmented as far as its conditioning asks for, from this weight on. The weight
// changes no solution, and not the inertia.
Factorisation factorise_well(Programme& programme, double shift, double augmentation);

// A step length that the filter accepts, relative to the longest step; 0: none. The programme has moved.
struct StepLength {
    double length = 0;
    bool by_cost = false;       // for the decrease of the cost
    bool is_corrected = false;  // a second-order correction was tried
    Trial trial;                // what the step leaves
};

// For the programme's iterate, of which `first` is told.
Filter start_filter(const Programme& programme, const Trial& first);

// Halves the step down to the shortest; a full step that is refused is given one second-order correction. A step with
// which slacks stop has to lower the violation.
StepLength search(Programme& programme, const Filter& filter, const Trial& before, const CappedDirection& direction,
                  double shortest, bool may_stop);

// The barrier parameter falls as far as the conditions of the barrier problem allow at the iterate, which `e` is of;
// the evaluation with it. Where limits bend much one parameter takes many iterations, and one far below it more:
// `is_slow`, it falls earlier, and less.
Evaluation lower_barrier(Programme& programme, Evaluation e, double least, bool is_slow);

}  // namespace mbocp
