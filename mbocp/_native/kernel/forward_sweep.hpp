// The state from the first one and the controls, step after step (eq. 29).
#pragma once

#include "elimination.hpp"

namespace mbocp {

class ForwardSweep {
public:
    ForwardSweep(const Problem& problem, Iterate& iterate, Step& step, const Elimination& gains);

    // A warm sweep starts each step from the iterate, a cold one from the state before. With `feedback` the controls
    // answer deviations from the iterate's states with the gains of the last factorisation, which keeps a sweep of an
    // unstable system near them. Compensated, the rows of each state take what its rounding left of the rows before
    // (Hairer, Lubich, Wanner, section VIII.5): errors of many steps do not add up, and the rows of a step alone vanish
    // to round-off only.
    Sweep run(double tolerance, int max_iterations, bool warm, bool feedback, bool compensated);

private:
    bool feed_back(int n);
    bool solve(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep);
    double residual(const StageFunction& f);
    bool is_contracting(int n, double factor);

    const Problem& problem_;
    Iterate& iterate_;
    Step& step_;
    const Elimination& gains_;
    Numbers c_, direction_, simplified_, dx_, x_before_, y_before_;
    Numbers left_over_;  // rows of the states so far, as rounded; zero unless compensated
    Numbers planned_;    // x_{n+1} before it is swept
};

}  // namespace mbocp
