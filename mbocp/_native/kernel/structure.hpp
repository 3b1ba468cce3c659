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

// One factored step; the numbers belong to the stage.
struct StepFactor {
    double *inverse = nullptr, *Z = nullptr;                 // of the groups
    double *N = nullptr, *KN = nullptr, *D = nullptr;        // KN = (dt Mq + Mv) N, D = N'KN
    int *pivot = nullptr, *column = nullptr, *free = nullptr;  // of D; pivot column of a constraint row; E
    int* list = nullptr;                                       // work
    double dt = 0;
};

class Structure {
public:
    // `jacobian` over (q, v, r, y, q_before, v_before, r_before, u). Throws where its pattern does not fit.
    Structure(const Pattern& jacobian, int ndx, int ny, int nu, const std::vector<GroupOfRows>& groups);

    int nq = 0, nr = 0, ny = 0, nu = 0, d = 0;  // d: free columns
    SparseRows Jw, Js;                          // all rows, in (q, v, r, y) and in (x_before, u)

    int ndx() const { return 2 * nq + nr; }
    int nw() const { return ndx() + ny; }

    std::size_t num_doubles() const;  // of a StepFactor, and
    std::size_t num_ints() const;
    void place(StepFactor& f, double* doubles, int* ints) const;
    // Workspace of `factor`, and of solutions with `columns` right-hand sides.
    std::size_t work_size(int columns) const;

    // Relative size of the smallest pivot; 0 when singular or not finite.
    double factor(const double* values, StepFactor& f, double* work) const;
    // B <- Jw^{-1} B for a row-major B with ld columns, a multiple of four. Without `constraints` their rows are zero.
    void solve(const double* values, const StepFactor& f, double* B, int ld, bool constraints, double* work) const;
    void solve_vector(const double* values, const StepFactor& f, double* b, double* work) const;
    // b <- Jw^{-T} b.
    void solve_transposed(const double* values, const StepFactor& f, double* b, double* work) const;
    // The same in two parts, for b that is known only along the null space at first. `along` is N'(dt bq + bv): the
    // momentum rows' multipliers from it and b's last rows, by; then the others from all of b.
    void momentum_multipliers(const double* values, const StepFactor& f, const double* along, const double* by,
                              double* mm, double* work) const;
    void other_multipliers(const double* values, const StepFactor& f, double* b, const double* mm,
                           double* work) const;
    // dq with Gd dq = scale c that is zero in the free columns.
    void particular(const double* values, const StepFactor& f, const double* c, double scale, double* dq,
                    double* work) const;

private:
    struct Group {
        int first = 0, rows = 0;
        bool closes_loop = false;
        std::vector<int> columns;          // own
        std::vector<bool> candidate;       // by column of q; loops only
        SparseRows own, others;            // own columns counted by themselves; loops: all are others
        int free_before = 0;               // free columns of the groups before
        std::size_t inverse = 0, Z = 0;    // where in a StepFactor

        int width() const { return static_cast<int>(columns.size()); }
    };

    void check_rows(const Pattern& jacobian);
    void make_groups(const Pattern& jacobian, const std::vector<GroupOfRows>& groups);
    void check_groups(const std::vector<GroupOfRows>& groups) const;
    std::size_t solve_size(int ld) const;
    double eliminate_own(const Group& g, const double* values, StepFactor& f, double* N, int* at, double* work) const;
    double eliminate_loop(const Group& g, const double* values, StepFactor& f, double* N, int* at,
                          double* work) const;
    // X with Gd X = C, zero in the free columns; and Y with Gd'Y = R for R that N' takes to zero; R is spoilt.
    void particular_matrix(const double* values, const StepFactor& f, const double* C, int ld, double* X,
                           double* work) const;
    void multipliers_matrix(const double* values, const StepFactor& f, double* R, int ld, double* Y,
                            double* work) const;

    std::vector<Group> groups_;
    std::vector<int> unowned_;  // columns that no group calls its own
    SparseRows Mq_, Mv_;        // momentum rows in q, v
    int most_free_ = 0;         // free columns before loops are closed
    int most_rows_ = 0, most_candidates_ = 0;
    std::size_t inverse_size_ = 0, Z_size_ = 0;
    std::vector<int> kinematic_;  // indices of the kinematic rows' nonzeros: q, v, q_before
};

}  // namespace mbocp
