// The sweeps that staggered solvers make: state forward, eq. (29), adjoint backward, eq. (30). After them only r_u,
// eq. (31), is left: the end condition and the gradient of the control Hamiltonian in the controls.
#pragma once

#include "programme.hpp"

namespace mbocp {

struct SweepOutcome {
    Evaluation evaluation;  // not finite where the forward sweep failed
    int failed_stage = -1;  // in which step it did
};

// State and adjoint for the controls and eta that the programme holds; its x, y and m are replaced. Each step starts
// from the state and the algebraic unknowns that the programme holds. In closed loop with the gains of the last
// factorisation.
SweepOutcome sweep(Programme& programme, bool auxiliary, bool feedback);

// Puts the end condition's multiplier for which the control gradient is smallest into a swept programme. With the
// sensitivities G = dg/du of the end condition the control equation is linear in eta, grad_u H = h + G' eta; the
// smallest one, in the metric sum dt |u|^2, is orthogonal to the rows of G.
Evaluation find_end_multiplier(Programme& programme, bool auxiliary, bool feedback);

}  // namespace mbocp
