// Hessian of the problem that is left when state and adjoint equations are solved (the paper's K), column by column:
// quadratic work in the number of stages, and the reference for the structured factorisation.
#pragma once

#include "step.hpp"

namespace mbocp {

// In (eta, u) at the last evaluation, with `shift` on every state's diagonal: dense, symmetric, (ng + nu_total)^2
// entries. Throws where a step is singular.
Numbers reduced_hessian(const Problem& problem, const Data& data, Step& step, double shift);

}  // namespace mbocp
