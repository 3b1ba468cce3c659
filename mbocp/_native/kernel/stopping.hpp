// When Newton's method has arrived, though round-off keeps residual or increment large.
//
// A row of the optimality conditions is a sum of terms that cancel at a solution. Its value cannot be brought below
// round-off of the largest of them. In the stationarity conditions these are of the size of the multipliers, in the
// state equations of the size of states and controls:
//
//     eps_d = 8 eps |(mu, dt zeta, eta, z)|,    eps_p = 8 eps |(x, u)|,    eps = 2^-52
//
// Where neither is above the tolerance, which takes numbers above 5e5, the tolerance is all that counts. Where one is,
// it stands for the tolerance in its part of the residual, and increments count relative to the unknowns they belong
// to.
//
// Where coefficients are large, too, terms are larger than the multipliers and the states: a chain of light links
// multiplies them by hundreds. What they come to shows in a residual whose unknowns are all moved by a small part of
// themselves, with random signs: it grows by that part of the root of its terms' squares. Two evaluations tell it,
// which is why it is asked only where steps have led no farther.
//
// At a singular configuration multipliers may grow without bound, until all that is left of stationarity is round-off,
// and the cost has no say any more. So what is left has to be small beside the gradient of the cost, too.
#pragma once

#include "newton_state.hpp"

namespace mbocp {

inline constexpr int many_still = 2;  // steps in a row that halve neither residual nor increment

// What round-off may leave of the primal and of the dual part of the residual; from the terms themselves, for which
// the programme is evaluated again as it was.
Sizes round_off(const Programme& programme);
Sizes round_off_of_terms(Programme& programme, const Evaluation& e);

// The residual, each part in units of its round-off by `tolerance` where that is above the tolerance.
double relative_residual(const Sizes& allowed, double primal, double dual, double tolerance);
// The last direction, each kind of unknowns relative to its own norm where that is above one.
double relative_increment(const Programme& programme);
// Whether what is left of stationarity is small beside the gradient of the cost.
bool has_a_say(Programme& programme, double dual);
// Whether round-off is above the tolerance, and residual and increment are no more than that allows.
bool is_resolved(const Programme& programme, double primal, double dual, double increment, double tolerance);
// Whether the residual is about round-off, of which so much is allowed, and the coming step would be far below the
// tolerance: by itself, or relative to the unknowns, the more of which there are, the more round-off it has.
bool is_at_rest(double residual, double allowed, double coming, double relative, double tolerance);

// Whether round-off is above the tolerance, has a say in the residual, and leaves no more to gain.
bool is_within_round_off(const NewtonState& state, double tolerance);
// Whether the residual is far below the tolerance, and increments are round-off, or will be. Where steps are short and
// constraints are many, the multipliers' increments stay above the tolerance though the residual is as small as it
// gets.
bool has_arrived(const NewtonState& state, double tolerance);
// Whether a full step of Newton's method that is refused is one among round-off.
bool leads_no_farther(NewtonState state, double increment, double tolerance);
// How many steps in a row, with the one to this evaluation, halved neither residual nor increment.
int stillness(const NewtonState& state, const Evaluation& e, double increment);

}  // namespace mbocp
