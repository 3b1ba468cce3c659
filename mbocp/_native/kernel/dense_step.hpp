// Steps of 4 to 100 unknowns, as whole matrices.
//
// Rows that only add up speeds, a = D z + J s with w = (a, z), are not factorised: with Jw = [-1 D; A E] what is left
// is E + A D, of half the size.
#pragma once

#include "step.hpp"

namespace mbocp {

class DenseStep final : public Step {
public:
    DenseStep(const Problem& problem, Data& data) : problem_(problem), data_(data) {
        work_.allocate(static_cast<std::size_t>(problem.max_nw) + 16);
    }

    void add_places(int n, Places& places) const override;
    void store_first(int n, const StageFunction& jacobian) override;
    void add_jacobian(int n, const double* dw, const double* ds, double* c) const override;
    void add_jacobian_transposed(int n, const double* dm, double* w, double* s) const override;
    void add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const override;
    void copy_state_jacobian(int n, double* F, int ld) const override;
    double factor(int n) override;
    double factor_first(int n, const StageFunction& jacobian) override;
    void solve(int n, double* c) const override;
    void solve_transposed(int n, double* w) const override;
    double prepare_response(int n) override;
    void respond(int n, const double* ds, double* dw) const override;

private:
    double factor_rest(Stage& s) const;
    void respond_rest(const Stage& s) const;

    const Problem& problem_;
    Data& data_;
    Pool work_;
};

}  // namespace mbocp
