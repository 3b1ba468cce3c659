// What the Riccati recursion asks of a stage: to become a quadratic form over (state before, controls), whatever is
// between them, and to give that back in the forward pass; over whole states, or over the reachable ones.
#pragma once

#include <memory>

#include "barrier.hpp"
#include "controls.hpp"
#include "kkt_check.hpp"
#include "step.hpp"

namespace mbocp {

// What weighs the quadratic programme beside its derivatives.
struct Weights {
    double shift = 0;    // on the Hessian's diagonal in every state
    double augment = 0;  // of the end condition, see riccati.hpp
};

class Elimination {
public:
    virtual ~Elimination() = default;

    // The derivatives are those of another iterate; only the residual is another one.
    virtual void forget() = 0;
    virtual void forget_residual() = 0;

    // What delta of equations goes by, see `Barrier::learn`, before the first factorisation at an iterate.
    virtual void learn() {}

    // Value function P and columns S at the last node, the end condition not yet augmented. False where a stage's
    // matrix is singular.
    virtual bool start(const Residual& rhs, Factorisation& result) = 0;
    // Value function and columns at the node before stage n, gains of its controls, and its share of eta's matrix.
    virtual bool condense(int n, const Weights& weights, Factorisation& result) = 0;
    // Whether threads may share the stages: `condense_ahead` may come before `condense` then, in any order, and
    // `backward` after it, by any thread.
    virtual bool may_share() const { return false; }
    virtual void condense_ahead(int, int /*thread*/) {}

    // The backward half of KKT d = -rhs: t0, k and p, and the right-hand side r of eta. `prepare` comes first where
    // `start` has not seen this one.
    virtual void prepare(const Residual& rhs) = 0;
    virtual void start_backward(const Residual& rhs, const Weights& weights, Numbers& r) = 0;
    virtual void backward(int n, const Residual& rhs, const Weights& weights, Numbers& r) = 0;
    // The forward half from eta; with `check` also rhs + KKT d.
    virtual void forward(const Residual& rhs, const Weights& weights, Increment& out, KktCheck* check) = 0;
    // The same of states and controls alone.
    virtual void forward_motion(Increment& out) = 0;

    // What the gains make of a deviation of the state before stage n, du += K dx, and dx += K'du.
    virtual void feed_back(int n, const double* dx, double* du) const = 0;
    virtual void feed_back_transposed(int n, const double* du, double* dx) const = 0;
};

std::unique_ptr<Elimination> make_elimination(const Problem& problem, Data& data, Step& step, Barrier& barrier,
                                              EndMultiplier& eta);

}  // namespace mbocp
