// Unknowns of a step that follow from the others: with w = (a, z), in any order, a = D z + J s by rows of their own.
//
// The other rows, A a + E z + B s, leave E + A D to factorise, and the response z = V s is all that the recursion
// needs. Configurations follow that only add up speeds, in any coordinates, and forces that states remember.
#pragma once

#include "data.hpp"

namespace mbocp {

// Followers of a stage, where its numbers are, and its factors. A has columns of those alone that the other rows know.
struct FollowersOf {
    explicit FollowersOf(const Stage& s);

    double D(const Entry& e) const { return Jw[e.row * pw + of.z[e.column]]; }
    double J(const Entry& e) const { return Js[e.row * ps + e.column]; }
    // Whether rows are -a + D z + J s here, with D small enough to lose no digits without pivoting.
    bool fit() const;
    double factor() const;  // as `Step::factor` does
    void respond() const;   // V <- -(E + A D)^{-1} (B + A J)
    void complete() const;  // T from V
    void solve(double* c) const;
    void solve_transposed(double* w) const;
    // As `Step` does.
    void add_jacobian(const double* dw, const double* ds, double* c) const;
    void add_jacobian_transposed(const double* dm, double* w, double* s) const;
    // dw += T ds; ds += T'dw
    void add_response(const double* ds, double* dw) const;
    void add_response_transposed(const double* dw, double* ds) const;

    const Followers& of;
    const int nw, ns, nz, nk, pw, ps, pz, pk;
    const double *Jw, *Js;
    double *E, *A, *V, *T;
    int* pivot;

private:
    double *of_z_, *known_;  // workspace of one right-hand side
};

// Numbers of a stage's memory behind its E.
std::size_t size_of_followers(const Kind& k);

}  // namespace mbocp
