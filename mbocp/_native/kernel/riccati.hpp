// One Newton step of the whole horizon: eliminate each stage, walk backward (Riccati), then forward.
//
// The end condition's multiplier eta rides along as extra right-hand sides, which are the auxiliary adjoint A of
// eqs. (33)-(44) of the first paper; S below. Work and memory grow linearly with the number of stages.
//
// Propagating S with the open-loop dynamics is single shooting in disguise: on an unstable system its columns become
// parallel and the Schur complement of eta singular to working precision. The quadratic programme is therefore first
// augmented by rho/2 |g + g_x dx|^2, which changes neither its solution nor the inertia of its KKT matrix, but closes
// the loop: S then follows A + BK, and the Schur complement tends to -1/rho.
#pragma once

#include "elimination.hpp"

namespace mbocp {

class Riccati {
public:
    Riccati(const Problem& problem, Data& data, Step& step, Barrier& barrier);

    // The derivatives are those of another iterate; only the residual is another one, as where the barrier parameter
    // changes.
    void forget();
    void forget_residual();
    void forget_right_hand_side();  // of the limits alone: the factors stay
    void learn() { elimination_->learn(); }

    // `shift` is added to the Hessian's diagonal in every state, `augment` weighs the end condition.
    Factorisation factorise(double shift, double augment);
    Direction solve(int refinements);
    // How far limits allow to go in states and controls along the direction; in `direction` without multipliers, which
    // take twice as long; the limits' equations hold to their delta.
    Direction solve_motion();
    // The direction for other values of the constraints: alpha times those of the iterate, plus these.
    Direction correct(double alpha, const Numbers& c, const Numbers& g);
    // KKT d = rhs of another right-hand side, in which `equations` belongs to the limits that are equations: d in
    // `direction`, their multipliers in the barrier. The programme is evaluated again before the next Newton step.
    // Returns the largest entry of what is left, by the largest of the terms.
    double solve_for(const Residual& rhs, const Numbers& equations);
    const KktCheck& check() const { return check_; }  // of the last solution
    // -KKT^-1 of what is left of some solutions: by how much round-off in these makes them wrong.
    const Increment& correction_for(const Residual& left);

    const Increment& direction() const { return direction_; }
    const Elimination& elimination() const { return *elimination_; }

private:
    enum class Known { nothing, factors, backward };  // the latter: also the backward half for rhs_

    void gather_residual();  // of stages and end
    void gather_right_hand_side();
    bool condense(Factorisation& f);
    bool condense_together(Factorisation& f);
    void backward(const Residual& rhs);
    void start_forward(Increment& out);
    void forward(const Residual& rhs, Increment& out, KktCheck* check);
    Direction finish(int refinements);
    Direction refine(int refinements, const Barrier::Accuracy& accuracy);
    void measure(Direction& d) const;

    const Problem& problem_;
    Data& data_;
    Barrier& barrier_;
    EndMultiplier eta_;
    std::unique_ptr<Elimination> elimination_;
    KktCheck check_;
    Known known_ = Known::nothing;
    Weights weights_;  // of the last factorisation
    Residual rhs_;
    Numbers eta_rhs_;
    Increment direction_, correction_;
    Section section_;  // of the recursion
    Ahead ahead_;
    Behind behind_;
};

}  // namespace mbocp
