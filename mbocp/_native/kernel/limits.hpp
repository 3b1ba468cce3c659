// Limits of states and controls, path functions and guards of the end condition: rows lower <= h(x, u) <= upper.
//
// A stage's rows are those of the state at its end, of its controls, and of the path functions; the guards' come last.
// States are plain vectors where there are any (nx = ndx). With a structure only controls can have limits.
#pragma once

#include <vector>

#include "iterate.hpp"

namespace mbocp {

// Bounds at the nodes 1..N and in all steps, infinite where there are none.
struct Bounds {
    Numbers x_lower, x_upper, u_lower, u_upper, path_lower, path_upper;
    int num_guards = 0;  // which must not be negative
};

class Limits {
public:
    explicit Limits(const Problem& problem) : problem_(problem) {}

    // `path` is (x, m, u, theta) -> h, dh_dx, upper Hessian of m'h, at the end of a step; `guard` likewise of (x_N, m,
    // rho_terminal).
    void set(const Bounds& bounds, Function path, Function guard);

    int rows_of_stage() const { return rows_; }
    int num_rows() const { return static_cast<int>(lower.size()); }
    bool empty() const { return lower.empty(); }
    const std::vector<int>& of_u() const { return u_; }
    int first_of_u(int n) const { return n * rows_ + static_cast<int>(x_.size()); }

    // h at a point; `evaluate` also its derivatives, and those of lambda'h in the nodes' states and in the controls.
    bool values(const Point& at, Numbers& h);
    bool evaluate(const Point& at, const Numbers& lambda, Numbers& h);
    const double* state_gradient(int n) const { return gradient_x_.data() + problem_.dx_offset(n); }
    const double* control_gradient(int n) const { return gradient_u_.data() + problem_.u_offset[n]; }

    // With J the rows' derivatives at the point of the last `evaluate`: rows <- J d, and adds J'weights to gradients.
    void along(const Increment& d, Numbers& rows) const;
    void add_transposed(const Numbers& weights, Residual& out) const;
    // B <- Hessian of lambda'h plus J' diag(weights) J in a node's state, of path functions and guards.
    void weigh(const Numbers& weights);
    // P += that Hessian at the end of stage n, all rows of the state included.
    void add_to_value(int n, const Numbers& weights, double* P) const;
    // Hx += (that Hessian) dx, and likewise for the controls.
    void add_products(int n, const Numbers& weights, const double* dx, const double* du, double* Hx, double* Hu) const;

    Numbers lower, upper;  // of all rows

private:
    bool call_path(int n, const Point& at, double* h, double* J, double* H);
    bool call_guard(const Point& at, double* h, double* J, double* H);
    void copy_values(int n, const Point& at, double* h) const;
    const double* jacobian(int n) const;  // of the path functions at a node
    const double* matrix(int n) const;    // B, or null
    std::size_t matrix_offset(int n) const;

    const Problem& problem_;
    std::vector<int> x_, u_;  // limited entries of a state and of the controls
    int nh_ = 0, num_guards_ = 0, rows_ = 0;
    Function path_, guard_;
    Numbers lambda_;                   // multipliers of the last `evaluate`
    Numbers gradient_x_, gradient_u_;  // of lambda'h
    Numbers J_, guard_J_, H_, B_;      // of the nodes' path functions and of the guards
};

}  // namespace mbocp
