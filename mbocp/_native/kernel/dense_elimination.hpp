// Elimination over whole states.
#pragma once

#include <algorithm>

#include "elimination.hpp"

namespace mbocp {

class DenseElimination final : public Elimination {
public:
    DenseElimination(const Problem& problem, Data& data, Step& step, Barrier& barrier, EndMultiplier& eta);

    void forget() override { std::fill(pivots_.begin(), pivots_.end(), -1.0); }
    void forget_residual() override {}
    void learn() override;
    bool start(const Residual& rhs, Factorisation& result) override;
    bool condense(int n, const Weights& weights, Factorisation& result) override;
    bool may_share() const override { return true; }
    void condense_ahead(int n, int thread) override { pivots_[n] = step_.prepare_response(n, thread); }
    void prepare(const Residual&) override {}
    void start_backward(const Residual& rhs, const Weights& weights, Numbers& r) override;
    void backward(int n, const Residual& rhs, const Weights& weights, Numbers& r) override;
    void forward(const Residual& rhs, const Weights& weights, Increment& out, KktCheck* check) override;
    void forward_motion(Increment& out) override;
    void feed_back(int n, const double* dx, double* du) const override;
    void feed_back_transposed(int n, const double* du, double* dx) const override;

private:
    // Of that many joints, see Kind, or of any number where it is 0.
    template <int Joints>
    void add_up(const Stage& s, double shift, double* H) const;
    template <int Joints>
    Form form_of_rest(const Stage& s, double shift);
    Form form_of_others(const Stage& s, double shift);
    void learn(int n);
    Form whole_form(const Stage& s, double shift);
    Form take_form(const Kind& k, Space& space, bool is_connected = false) const;
    void add_hessian(const Stage& s, const Form& form) const;
    void find_motion(int n, double* dw, double* ds, Increment& out) const;
    void forward_stage(int n, const Residual& rhs, const Weights& weights, Increment& out);

    const Problem& problem_;
    Data& data_;
    Step& step_;
    Barrier& barrier_;
    Controls controls_;
    Pool work_, vectors_;  // the latter of right-hand sides
    Numbers pivots_;       // of stages that are ahead, below zero of others
    Section section_;
    Behind behind_;
};

}  // namespace mbocp
