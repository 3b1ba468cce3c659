// The multiple of the identity that a Newton method adds to its Hessian in the states, in units of a control's weight:
// how it changes from one try to the next, and from one step to the next.
#pragma once

#include <algorithm>

namespace mbocp {

struct Care {
    // Factors of the shift: where a step did not do; where the Hessian is indefinite and the size of a shift is known;
    // after a good step.
    double growth, regrowth, shrinkage;
    double min_step;     // a step length below which a larger shift is tried first ...
    int patience;        // ... this many times
    double after_short;  // what the shift is at least after a short step: a smaller one changes nothing of a step

    static constexpr Care bold() { return {8.0, 4.0, 3.0, 0.02, 3, 1e-2}; }
    // While full steps follow one another from a large shift on, with which it began: penalties that are far from met
    // ask for it, and soon no longer. Legged robots with penalties took 0.7 to 0.84 of the iterations.
    static constexpr Care fast() { return {8.0, 4.0, 30.0, 0.02, 3, 1e-2}; }
    static constexpr bool is_large(double shift) { return shift > 1e3; }
    // Along valleys with negative curvature a shift that shrinks too far costs several short steps each time; smaller
    // factors took a third fewer iterations on drones that spent hundreds there.
    static constexpr Care careful() { return {3.0, 3.0, 3.0, 0.4, 8, 0.0}; }

    // Next one to try where a shift did not do; `least` is the smallest one there is, but none.
    double larger_shift(double shift, double least) const { return std::max(growth * shift, least); }

    // Next one to try where the Hessian is indefinite; `last` is what the last step has taken, 0 if nothing has told of
    // the size yet: then it is looked for as in [Waechter2006].
    double regrown_shift(double shift, double last, double least) const {
        constexpr double first = 1e-2, first_growth = 30.0, of_last = 0.2;
        if (last == 0.0) return std::max(first_growth * shift, first);
        return std::max({regrowth * shift, least, of_last * last});
    }

    // Where the next iteration begins, after this part of a Newton step and contraction of the residual.
    double next_shift(double shift, double length, double contraction, double least) const {
        constexpr double good_step = 0.2, fast = 0.1;
        if (length < good_step) return std::max(2.0 * std::max(shift, least), after_short);
        if (length == 1.0 && contraction < fast) return 0.0;  // Newton's own convergence has set in
        return shift / shrinkage > least ? shift / shrinkage : 0.0;
    }
};

}  // namespace mbocp
