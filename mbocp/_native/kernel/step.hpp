// A stage's derivatives and its linearised step, Jw dw + Js ds + c = 0 with w = (x, y) and s = (state before, u):
// dense, or with a structure.
#pragma once

#include <memory>

#include "data.hpp"
#include "scatter.hpp"

namespace mbocp {

class Step {
public:
    virtual ~Step() = default;

    // Where in the memory of a stage the derivatives belong that `complete` gives; after they have been put there, and
    // after a call of `jacobian`.
    virtual void add_places(Places& places) const = 0;
    virtual void receive(int) {}
    virtual void store_first(int n, const StageFunction& jacobian) = 0;

    // c += Jw dw + Js ds
    virtual void add_jacobian(int n, const double* dw, const double* ds, double* c) const = 0;
    // w += Jw'dm, s += Js'dm, each where it is not null
    virtual void add_jacobian_transposed(int n, const double* dm, double* w, double* s) const = 0;
    // w += Hww dw + Hws ds, s += Hss ds + Hws'dw
    virtual void add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const = 0;
    // F <- Jw's rows of the dynamics in the state, with leading dimension ld.
    virtual void copy_state_jacobian(int n, double* F, int ld) const = 0;

    // Factorises Jw; returns the relative size of the smallest pivot, 0 where it is singular or not finite.
    virtual double factor(int n) = 0;
    // The same for Jw as `jacobian` has just returned it.
    virtual double factor_first(int n, const StageFunction& jacobian) = 0;
    // c <- Jw^{-1} c and w <- Jw^{-T} w with the last factors.
    virtual void solve(int n, double* c) const = 0;
    virtual void solve_transposed(int n, double* w) const = 0;
    // dw <- -Jw^{-1} Js ds, after `prepare_response`, which factorises Jw and returns as that does. Threads may prepare
    // dense steps side by side.
    virtual double prepare_response(int n, int thread) = 0;
    virtual void respond(int n, const double* ds, double* dw) const = 0;
};

std::unique_ptr<Step> make_step(const Problem& problem, Data& data);

}  // namespace mbocp
