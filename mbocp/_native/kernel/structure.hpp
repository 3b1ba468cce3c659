// Steps with a large state and many constraints, as in natural coordinates, through the null space of the constraints.
//
// The state is x = (q, v, r), and the rows of a step are
//
//   q_before + dt v - q = 0           kinematics
//   momentum balance in q, v, u, the state before, and -G(q)'y
//   u - r = 0                         remembered controls, or none
//   Phi(q) / dt = 0                   constraints, with Jacobian Gd = G / dt
//
// Gd is eliminated group by group: a group's rows pivot among columns of its own, or, where it closes a loop, among
// what is still free. Columns without a pivot are the free ones E, and with N the basis of Gd's null space that is the
// identity in the rows E,
//
//   dq = N alpha + a particular part,      alpha = dq[E],
//
// the momentum balance is left with as many rows, N' times it, as there are free columns.
#pragma once

#include <vector>

#include "sparse.hpp"

namespace mbocp {

// Constraint rows that are eliminated together, and the columns of q among which they may pivot; none: all free ones.
struct GroupOfRows {
    int first = 0, rows = 0;
    std::vector<int> columns;
};

// One factored step, and the states that are reachable at its end; the numbers belong to the stage.
struct StepFactor {
    double *inverse = nullptr, *Z = nullptr;                   // of the groups
    double *N = nullptr, *KN = nullptr, *D = nullptr;          // KN = (dt Mq + Mv) N, D = N'KN
    double* V = nullptr;                                       // see `reach`
    int *pivot = nullptr, *column = nullptr, *free = nullptr;  // of D; pivot column of a constraint row; E
    int* list = nullptr;                                       // work
    double dt = 0;
};

// Rows of a symmetric matrix's half over (q, v, r).
struct OverState {
    Panels q, v, r;

    bool empty() const { return q.empty() && v.empty() && r.empty(); }
};

class Structure {
public:
    // `jacobian` over (q, v, r, y, q_before, v_before, r_before, u). Throws where its pattern does not fit.
    Structure(const Pattern& jacobian, int ndx, int ny, int nu, const std::vector<GroupOfRows>& groups);

    int nq = 0, nr = 0, ny = 0, nu = 0, d = 0;  // d: free columns
    SparseRows Jw, Js;                          // all rows, in (q, v, r, y) and in (x_before, u)

    int ndx() const { return 2 * nq + nr; }
    int nw() const { return ndx() + ny; }
    int nd() const { return 2 * d + nr; }  // entries of xi, the coordinates of reachable states

    std::size_t num_doubles() const;  // of a StepFactor, and
    std::size_t num_ints() const;
    void place(StepFactor& f, double* doubles, int* ints) const;
    std::size_t work_size() const;

    // Relative size of the smallest pivot; 0 when singular or not finite.
    double factor(const double* values, StepFactor& f, double* work) const;
    // b <- Jw^{-1} b and b <- Jw^{-T} b.
    void solve_vector(const double* values, const StepFactor& f, double* b, double* work) const;
    void solve_transposed(const double* values, const StepFactor& f, double* b, double* work) const;
    // The latter in two parts, for b that is known only along the null space at first. `along` is N'(dt bq + bv): the
    // momentum rows' multipliers from it and b's last rows, by; then the others from all of b.
    void momentum_multipliers(const double* values, const StepFactor& f, const double* along, const double* by,
                              double* mm, double* work) const;
    void other_multipliers(const double* values, const StepFactor& f, double* b, const double* mm, double* work) const;
    // y of the momentum rows from states and controls, with their residual cm.
    void balance(const double* values, const StepFactor& f, const double* x, const double* s, const double* cm,
                 double* y, double* work) const;
    // X with Gd X = C that is zero in the free columns, padded(d) of them.
    void particular_matrix(const double* values, const StepFactor& f, const double* C, double* X, double* work) const;

    // Reachable states dx = B xi, xi = (alpha, gamma, dr): dq = N alpha, dv = V (alpha, gamma). At the first step's end
    // there is nothing before.
    void reach(StepFactor& f, const StepFactor* before, double* work) const;
    // Written into zeros, B has padded(nd()) columns.
    void basis(const StepFactor& f, double* B) const;
    // dx += scale B xi and g += B'h; xi and g have padded(nd()) entries.
    void expand(const StepFactor& f, const double* xi, double* dx, double scale = 1.0) const;
    void project(const StepFactor& f, const double* h, double* g) const;
    // Y += L B for some rows of L; M += B'Y; M += B'B. Y and B have padded(nd()) columns, M has ldm.
    void times_basis(const OverState& L, const double* values, const StepFactor& f, double* Y) const;
    void project_matrix(const StepFactor& f, const double* Y, double* M, int ldm) const;
    void gram(const StepFactor& f, double* M, int ldm) const;
    // Of the coordinates before and the controls, in `ld` columns: R, what they make of the momentum rows, negative;
    // beta, of N beta, which takes that out of the free directions; T, the coordinates afterwards.
    void respond(const double* values, const StepFactor& f, const StepFactor* before, double* R, double* beta,
                 double* T, int ld, double* work) const;
    // What a multiplier of the momentum rows means for the state before and the controls.
    void respond_transposed(const double* values, const StepFactor& f, const double* mm, double* s) const;

private:
    struct Group {
        int first = 0, rows = 0;
        bool closes_loop = false;
        std::vector<int> columns;        // own
        std::vector<bool> candidate;     // by column of q; loops only
        SparseRows own, others;          // own columns counted by themselves; loops: all are others
        int free_before = 0;             // free columns of the groups before
        std::size_t inverse = 0, Z = 0;  // where in a StepFactor

        int width() const { return static_cast<int>(columns.size()); }
    };

    void check_rows(const Pattern& jacobian);
    void make_groups(const Pattern& jacobian, const std::vector<GroupOfRows>& groups);
    void check_groups(const std::vector<GroupOfRows>& groups) const;
    double eliminate_own(const Group& g, const double* values, StepFactor& f, double* N, int* at, double* work) const;
    double eliminate_loop(const Group& g, const double* values, StepFactor& f, double* N, int* at, double* work) const;
    // dq with Gd dq = c that is zero in the free columns; and y with Gd'y = r for r that N' takes to zero; r is spoilt.
    void particular(const double* values, const StepFactor& f, const double* c, double* dq, double* work) const;
    void multipliers(const double* values, const StepFactor& f, double* r, double* y, double* work) const;

    std::vector<Group> groups_;
    std::vector<int> unowned_;        // columns that no group calls its own
    SparseRows Mq_, Mv_, Mx_;         // momentum rows in q, v, and all of the state
    SparseRows Mq0_, Mv0_, Mu_, Ms_;  // in the state before, the controls, and both
    SparseRows ru_;                   // remembered controls' rows in the controls
    int most_free_ = 0;               // free columns before loops are closed
    int most_rows_ = 0, most_candidates_ = 0;
    std::size_t inverse_size_ = 0, Z_size_ = 0;
    std::vector<int> kinematic_;  // indices of the kinematic rows' nonzeros: q, v, q_before
};

}  // namespace mbocp
