// First derivatives of the problem in the controls: multipliers from eta, backwards (eq. 30), or those of the auxiliary
// adjoint, m = sigma + A eta (eqs. 42-44).
#pragma once

#include "elimination.hpp"

namespace mbocp {

class AdjointSweep {
public:
    AdjointSweep(const Problem& problem, Iterate& iterate, Data& data, Step& step, const Elimination& gains);

    // Cost, first derivatives, and multipliers. The residual is r_u (eq. 31): end condition and control gradients. With
    // `feedback` it is the adjoint of the sweep in closed loop, u + K (x - x_planned); the two agree where r_u
    // vanishes.
    Evaluation run(bool auxiliary, bool feedback);
    // Derivative of the end condition in all controls after a `run`, (ng, nu_total); likewise.
    Numbers end_sensitivity(bool feedback);

    // The auxiliary adjoint of the last `run(true, ...)`: sigma, and A with ng columns, both for the rows of the
    // dynamics, stage after stage.
    Numbers sigma, A;

private:
    bool evaluate_stage(int n, Evaluation& e);
    bool find_multipliers(int n, const double* after, bool auxiliary);
    bool find_auxiliary(int n, double* now);
    void measure_end(Evaluation& e, double squared) const;

    const Problem& problem_;
    Iterate& iterate_;
    Data& data_;
    Step& step_;
    const Elimination& gains_;
    Numbers S_;  // of the auxiliary adjoint: what A_n leaves at x_n, a row for each entry of eta
    Pool work_;
};

}  // namespace mbocp
