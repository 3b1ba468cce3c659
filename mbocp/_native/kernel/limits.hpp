// Limits of states and controls, path functions and guards of the end condition: rows lower <= h(x, u) <= upper, or
// h(x, u) = value where both sides are the same.
//
// A stage's rows are those of the state at its end, of its controls, and of the path functions, as far as they are
// bounded there; the guards' come last. States are plain vectors where there are any (nx = ndx). With a structure only
// controls can have limits.
#pragma once

#include <utility>
#include <vector>

#include "iterate.hpp"
#include "scatter.hpp"

namespace mbocp {

// Bounds at the nodes 1..N and in all steps, infinite where there are none: a row for each of them, or one for all.
struct Bounds {
    Numbers x_lower, x_upper, u_lower, u_upper, path_lower, path_upper;
    int num_guards = 0;  // which must not be negative
};

struct Equation {
    int row;
    double value;
};

// Columns in which the derivatives of a row can be other than zero, and where they are among those of all rows.
struct Window {
    int first = 0, size = 0, at = 0;
};

// Those derivatives.
struct Slope {
    int first, size;
    const double* values;
};

class Limits {
public:
    // Where the rows of a stage's state, controls and path functions begin, and where they end.
    struct Rows {
        int x, u, path, end;
    };

    explicit Limits(const Problem& problem) : problem_(problem) {}

    // `path` is (x, m, u, theta) -> h, dh_dx, upper Hessian of m'h, at the end of a step; `path_values` is
    // (x, u, theta) -> h; `guard` like `path` of (x_N, m, rho_terminal).
    void set(const Bounds& bounds, Function path, Function path_values, Function guard);

    Rows of_stage(int n) const { return stages_[static_cast<std::size_t>(n)]; }
    int first_guard() const { return static_cast<int>(entry_.size()); }
    int entry(int row) const { return entry_[static_cast<std::size_t>(row)]; }  // of the state, the controls or h
    int num_rows() const { return static_cast<int>(lower.size()); }
    int num_inequalities() const { return num_rows() - static_cast<int>(equations.size()); }
    bool empty() const { return lower.empty(); }

    // h at a point; `evaluate` also its derivatives, and those of lambda'h in the nodes' states and in the controls.
    bool values(const Point& at, Numbers& h);
    bool evaluate(const Point& at, const Numbers& lambda, Numbers& h);
    const double* state_gradient(int n) const { return gradient_x_.data() + problem_.dx_offset(n); }
    const double* control_gradient(int n) const { return gradient_u_.data() + problem_.u_offset[n]; }
    // |dh/d(x, u)|^2 of an equation at the point of the last `evaluate`.
    double squared_slope(std::size_t equation) const;
    // That slope times the size of the state, or of the controls: of what the equation's value is a sum.
    double reach(std::size_t equation, const Point& at) const;
    std::pair<int, int> equations_of(int n) const { return {first_equation_[n], first_equation_[n + 1]}; }
    // dh_du diag(Huu)^-1 dh_du' of an equation, with the response and the Hessian of its stage as in `Barrier::learn`.
    double response(std::size_t equation, const double* T, const double* Hss, int ld, int nd) const;

    // With J the rows' derivatives at the point of the last `evaluate`: rows <- J d, and adds J'weights to gradients.
    void along(const Increment& d, Numbers& rows) const;
    void add_transposed(const Numbers& weights, Residual& out) const;
    // B <- Hessian of lambda'h plus J' diag(weights) J in a node's state, of path functions and guards.
    void weigh(const Numbers& weights);
    // P += that Hessian at the end of stage n, all rows of the state included.
    void add_to_value(int n, const Numbers& weights, double* P) const;
    // Hx += (that Hessian) dx, and likewise for the controls.
    void add_products(int n, const Numbers& weights, const double* dx, const double* du, double* Hx, double* Hu) const;

    Numbers lower, upper;  // of all rows; infinite for equations, which have no sides
    std::vector<Equation> equations;

private:
    void add_rows(int n, const std::vector<int>& found, const Numbers& lower_side, const Numbers& upper_side, int size);
    // What a thread has for itself: values of all path functions at a node, and multipliers of them at the nodes of the
    // lanes.
    struct Own {
        Numbers h, lambda;
    };

    // Of the nodes of as many stages as path functions have lanes, from number `first` of those that have any on.
    bool evaluate_group(std::size_t first, const Point& at, const Numbers& lambda, Numbers& h, int thread);
    bool evaluate_values(std::size_t first, const Point& at, Numbers& h, int thread);
    void set_states(StageFunction& function, std::size_t first, const Point& at) const;
    bool call_guard(const Point& at, double* h, double* J, double* H);
    void copy_values(int n, const Point& at, double* h) const;
    bool has_path(int n) const { return at_node_[static_cast<std::size_t>(n)] >= 0; }
    Slope slope(int n, int row) const {  // of a path function
        const Window& window = windows_[static_cast<std::size_t>(entry(row))];
        return {window.first, window.size, J_.data() + jacobian_offset(n) + window.at};
    }
    Slope guard_slope(int i) const {
        const Window& window = guard_windows_[static_cast<std::size_t>(i)];
        return {window.first, window.size, guard_J_.data() + window.at};
    }
    const double* matrix(int n) const;  // B, or null
    // work(its number, what can be other than zero) for each row of B.
    template <class Work>
    void for_rows_of_matrix(int n, Work work) const {
        const double* B = matrix(n);
        for (std::size_t i = 0; B && i < matrix_rows_.size(); ++i)
            if (const Window& row = matrix_rows_[i]; row.size > 0)
                work(static_cast<int>(i), Slope{row.first, row.size, B + row.at});
    }
    void add_to_matrix(const StageFunction& f, const std::vector<Window>& windows);
    // Of a node that has path functions; of the matrices, or has guards.
    std::size_t jacobian_offset(int n) const;
    std::size_t matrix_offset(int n) const;

    const Problem& problem_;
    std::vector<Window> windows_, guard_windows_;      // of the path functions at a node, and of the guards
    std::vector<Window> matrix_rows_;                  // of the rows of H and B
    std::size_t num_slopes_ = 0, size_of_matrix_ = 0;  // numbers of a node's derivatives, and of its matrix
    Scatter slopes_, curvature_;                       // of the path functions
    std::vector<Rows> stages_;
    std::vector<int> entry_;
    std::vector<int> with_path_;                     // stages whose nodes have path functions
    std::vector<int> at_node_;                       // place of a stage's node among those with path functions, or -1
    std::vector<int> first_equation_, of_equation_;  // of each stage; stage of each
    int nh_ = 0, num_guards_ = 0;
    Function path_, path_values_, guard_;
    bool may_share_ = false;  // whether each thread has path functions
    std::vector<Own> own_;    // of the threads
    Numbers guard_lambda_;
    Section of_derivatives_, of_values_, of_products_;
    Numbers gradient_x_, gradient_u_;  // of lambda'h
    Numbers J_, guard_J_, H_, B_;      // of the nodes' path functions and of the guards
};

}  // namespace mbocp
