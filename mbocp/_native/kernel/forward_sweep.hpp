// The state from the first one and the controls, step after step (eq. 29).
#pragma once

#include "elimination.hpp"

namespace mbocp {

class ForwardSweep {
public:
    ForwardSweep(const Problem& problem, Iterate& iterate, Step& step, const Elimination& gains);

    // A warm sweep starts each step from the iterate, a cold one from the state before. With `feedback` the controls
    // answer deviations from the iterate's states with the gains of the last factorisation, which keeps a sweep of an
    // unstable system near them.
    Sweep run(double tolerance, int max_iterations, bool warm, bool feedback);

private:
    bool feed_back(int n);
    bool solve(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep);
    double residual(int n, const StageFunction& f);
    bool is_contracting(int n, double factor);

    const Problem& problem_;
    Iterate& iterate_;
    Step& step_;
    const Elimination& gains_;
    Numbers c_, direction_, simplified_, dx_, x_before_, y_before_;
    Numbers planned_;  // x_{n+1} before it is swept
};

}  // namespace mbocp
