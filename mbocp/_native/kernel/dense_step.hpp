// Steps of 4 to 100 unknowns, as whole matrices.
//
// Rows that only add up speeds, a = D z + J s with w = (a, z), are not factorised: with Jw = [-1 D; A E] what is left
// is E + A D, of half the size. The first of them, as those of a floating base, may have blocks in place of diagonals,
// and another one than -1, by which they are divided first. Where Jw is a triangle of blocks by its pattern, only those
// on its diagonal are.
#pragma once

#include "step.hpp"

namespace mbocp {

class DenseStep final : public Step {
public:
    DenseStep(const Problem& problem, Data& data) : problem_(problem), data_(data) {
        size_ = (static_cast<std::size_t>(problem.kind().nw()) + 31) / 16 * 16;  // whole cache lines, two of them apart
        work_.allocate(size_ * problem.crew().size());
    }

    void add_places(Places& places) const override;
    void store_first(int n, const StageFunction& jacobian) override;
    void add_jacobian(int n, const double* dw, const double* ds, double* c) const override;
    void add_jacobian_transposed(int n, const double* dm, double* w, double* s) const override;
    void add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const override;
    void copy_state_jacobian(int n, double* F, int ld) const override;
    double factor(int n) override { return factor(n, 0); }
    double factor_first(int n, const StageFunction& jacobian) override;
    void solve(int n, double* c) const override;
    void solve_transposed(int n, double* w) const override;
    double prepare_response(int n, int thread) override;
    void respond(int n, const double* ds, double* dw) const override;

private:
    double factor(int n, int thread);
    double factor_lead(Stage& s) const;
    double factor_rest(Stage& s, int thread) const;
    void respond_rest(const Stage& s, int thread) const;
    double factor_blocks(Stage& s) const;
    void respond_blocks(const Stage& s) const;
    void solve_blocks(const Stage& s, double* c) const;
    void solve_blocks_transposed(const Stage& s, double* w) const;
    Space space(int thread) const { return Space(work_.data() + size_ * thread); }

    const Problem& problem_;
    Data& data_;
    Pool work_;
    std::size_t size_;  // of what a thread has of it
};

// Blocks of the direct rows' lead, see Stage.
struct Lead {
    explicit Lead(const Stage& s)
        : size(s.kind->lead), ld(dense::padded(size)), N(s.lead), D(N + size * ld), J(D + size * ld) {}

    void divide(double* c) const;  // c <- N c, and w <- N'w
    void divide_transposed(double* w) const;
    void add_before(const double* ds, const double* z, double* a) const;  // a += J ds - D z
    void add_transposed(const double* a, double* z, double* ds) const;    // z += D'a, ds += J'a

    const int size, ld;
    const double *N, *D, *J;
};

// The response T of a dense step, of which there are the rows of z alone where direct rows are left out:
// dw += T ds; ds += T'dw, which overwrites dw; and all its rows in their place.
void add_response(const Stage& s, const double* ds, double* dw);
void add_response_transposed(const Stage& s, double* dw, double* ds);
void complete_response(const Stage& s);
// w += Hww dw, s += Hws'dw
void add_hessian_of(const Stage& at, const double* dw, double* w, double* s);

}  // namespace mbocp
