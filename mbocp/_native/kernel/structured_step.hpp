// Steps in natural coordinates, sparse: see structure.hpp.
#pragma once

#include "step.hpp"

namespace mbocp {

class StructuredStep final : public Step {
public:
    StructuredStep(const Problem& problem, Data& data);

    void add_places(Places& places) const override;
    void receive(int n) override;
    void store_first(int n, const StageFunction& jacobian) override;
    void add_jacobian(int n, const double* dw, const double* ds, double* c) const override;
    void add_jacobian_transposed(int n, const double* dm, double* w, double* s) const override;
    void add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const override;
    void copy_state_jacobian(int n, double* F, int ld) const override;
    double factor(int n) override;
    double factor_first(int n, const StageFunction& jacobian) override;
    void solve(int n, double* c) const override;
    void solve_transposed(int n, double* w) const override;
    double prepare_response(int n, int) override { return factor(n); }
    void respond(int n, const double* ds, double* dw) const override;

private:
    const Problem& problem_;
    Data& data_;
    Pool work_;          // of the structure
    mutable Numbers z_;  // and H z
};

}  // namespace mbocp
