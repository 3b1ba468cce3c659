// Limits of states and controls, path functions and guards of the end condition: lower <= h(x, u) <= upper.
//
// Every one of them is a row with a slack s, h - s = 0, strictly between its bounds; in place of the bounds the cost
// gets the barrier -mu log(s - lower) - mu log(upper - s), and the multipliers z of the bounds are unknowns of their
// own (a primal-dual interior-point method, [Waechter2006]). Slacks and multipliers are eliminated from the linear
// system: a row adds J' Sigma J to the Hessian of its state or control, Sigma = z_l / (s - lower) + z_u / (upper - s).
#pragma once

#include <memory>
#include <vector>

#include "dense.hpp"
#include "stage_function.hpp"

namespace mbocp {

using Function = std::shared_ptr<StageFunction>;
using Numbers = std::vector<double>;

// Bounds at the nodes 1..N and in all steps, infinite where there are none.
struct Bounds {
    Numbers x_lower, x_upper, u_lower, u_upper, path_lower, path_upper;
    int num_guards = 0;  // which must not be negative
};

struct Limits {
    std::vector<int> x, u;  // limited entries of a state and of the controls
    int nh = 0, num_guards = 0;
    Function path;            // (x, m, u, theta) -> h, dh_dx, upper Hessian of m'h, at the end of a step
    Function guard;           // (x_N, m, rho_terminal) -> likewise
    int rows = 0, total = 0;  // of a stage: x, u, path; of all stages, with the guards at the end
    double barrier = 0;       // mu

    Numbers lower, upper;            // of all rows
    Numbers defect;                  // h - s
    Numbers sigma, force;            // Sigma; what the row adds to the right-hand side's gradient, before J'
    Numbers ds, dz_lower, dz_upper;  // of the last direction
    Numbers slack_trial;
    Numbers of_x, of_u;          // derivatives of lambda'h in the nodes' states and in the controls
    Numbers J, H, B;             // of a node's path functions; Hessian of lambda'h; that with J' Sigma J
    Numbers guard_J, h, lambda;  // of the guards; values; multipliers of one call

    bool empty() const { return total == 0; }
    bool has_matrix(int n, int N) const { return nh > 0 || (num_guards > 0 && n == N - 1); }
};

}  // namespace mbocp
