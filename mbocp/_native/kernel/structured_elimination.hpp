// Elimination of stages with a structure: value functions over the reachable states alone.
//
// Whatever the controls, the linearised constraints and kinematics of the steps up to node n leave
//
//   dq_n = N_n alpha,   dv_n = N_{n-1} gamma + (N_n - N_{n-1} C_n) alpha / dt,   C_n = N_n[E_{n-1}]
//
// and a part b_n that follows from the residuals of the two steps before. As N[E] is the identity, the coordinates
// xi = (alpha, gamma) are entries of dx_n themselves: dq_n[E_n] and dv_n[E_{n-1}]. With dx = B xi + b a stage becomes
// one over xi_{n-1}, xi_n and the controls, of 2 d entries, d the degrees of freedom, instead of all of the state's.
// That is done for each stage by itself; the Riccati recursion only sees what comes of it.
//
// y_n follows from the momentum rows. It is never formed for unit vectors: the Hessian knows it through (y, q) alone,
// and S'y, S = L_yq N, is A'(KN beta - R) / dt with Gd A = S.
//
// The multipliers need the whole costate, of which the value function knows B' times it. That is enough for the
// momentum rows; the others follow from them backwards, stage by stage, without a recursion that could grow.
#pragma once

#include <algorithm>

#include "elimination.hpp"

namespace mbocp {

class StructuredElimination final : public Elimination {
public:
    StructuredElimination(const Problem& problem, Data& data, Step& step, Barrier& barrier, EndMultiplier& eta);

    void forget() override { known_ = Known::nothing; }
    void forget_residual() override { known_ = std::min(known_, Known::stages); }
    bool start(const Residual& rhs, Factorisation& result) override;
    bool condense(int n, const Weights& weights, Factorisation& result) override;
    void prepare(const Residual& rhs) override;
    void start_backward(const Residual& rhs, const Weights& weights, Numbers& r) override;
    void backward(int n, const Residual& rhs, const Weights& weights, Numbers& r) override;
    void forward(const Residual& rhs, const Weights& weights, Increment& out, KktCheck* check) override;
    void forward_motion(Increment& out) override;
    void feed_back(int n, const double* dx, double* du) const override;
    void feed_back_transposed(int n, const double* du, double* dx) const override;

private:
    enum class Known { nothing, stages, residuals };  // reduced as of the last evaluation, whatever the shift

    const StepFactor* step_before(int n) const { return n > 0 ? &data_[n - 1].step : nullptr; }
    std::size_t work_size(const Kind& k) const;
    bool reduce(int n, Factorisation& result);
    void reduce_hessian(int n);
    void reduce_residual(int n, const Residual& rhs);
    void reduce_end();
    const double* find_motion(int n, double* dw, double* ds, Space& space, Increment& out) const;
    void forward_stage(int n, const Residual& rhs, const Weights& weights, Increment& out);
    void momentum_multipliers(int n, const Residual& rhs, const double* xi, Increment& out, Space& space);
    void other_multipliers(const Residual& rhs, Increment& out);

    const Problem& problem_;
    Data& data_;
    Step& step_;
    Controls controls_;
    Known known_ = Known::nothing;
    double smallest_pivot_ = 1.0;  // of the reduced stages
    Pool scratch_, work_;          // the latter of the structure, too
};

}  // namespace mbocp
