// Newton's method on all optimality conditions at once, section 5.1 of [Bijalwan2025], made safe: it takes the same
// steps as the paper's near a minimum, and makes sure that it gets there.
//
// Inertia. A step leads towards a minimum when the KKT matrix has exactly as many negative eigenvalues as constraints.
// The structured factorisation counts them for nothing. Where they are too many, the Hessian in the states is shifted
// by a growing multiple of the identity.
//
// Filter line search. A step is halved until it improves feasibility or cost without going back to anything worse in
// both. Where halving does not help, the shift grows instead, which bends the step towards one that changes the states
// least; after a good step it shrinks again.
//
// Multipliers of the guess. Where states are curved and multipliers by least squares explain the gradient, the first
// Hessian is taken with them, and not with zero. Where they start from zero and the first step is short, they are taken
// from a backward sweep along the guess instead, eq. (30), and the step is tried again.
//
// Cap. A shift that just makes the Hessian definite makes steps of hundreds of radians, of which the cap on turns
// leaves next to nothing: where that is less than a tenth, the shift grows.
//
// Relaxed steps. Linearised constraints bend away quickly (a rod, a rotation), and a full Newton step then violates
// them more than any line search accepts, though the next steps make up for it. Where three larger shifts still leave a
// step of less than a tenth, up to six steps are taken without judging them, and more while each halves the residual;
// if none of them is closer to feasible than the start of the run, the start is restored.
//
// Restoration. Where none of this allows a step of a fiftieth, a forward sweep in closed loop makes the state equations
// hold along nearly the same motion.
//
// Restart. Where no shift allows any step, the multipliers begin anew, twice at most: many short steps may have spoilt
// them.
//
// Limits enter by a barrier, whose parameter steps choose while that goes well (`centring.hpp`), and which else falls
// as soon as the conditions of its problem hold to a multiple of it. Everything above is then about the cost with the
// barrier, with slacks that stop at their bounds or cut the step, and multipliers that stay positive.
//
// On random rest-to-rest motions of arms without a velocity weight, where pure Newton fails, alternatives did worse:
// shifting controls instead of states, Gauss-Newton in place of a shift, an l1 merit function instead of the filter.
#pragma once

#include "newton_state.hpp"
#include "newton_step.hpp"
#include "shift.hpp"

namespace mbocp {

struct NewtonSettings {
    double tolerance = 1e-9;  // of residual and increment
    int max_iterations = 200;
    double control_weight = 1.0;  // unit of the shift: the cost's weight of one control over one step
    bool is_careful = false;      // it begins where many steps have led along a valley
    double rough = 0.0;           // residual with which it ends, whatever the increment; 0: it is to converge
};

// Slacks and limits' multipliers that begin from nothing, and the barrier parameter that suits a guess; 0: there are
// equations alone, or no limits.
double first_barrier(Programme& programme);

class Newton {
public:
    explicit Newton(NewtonSettings settings) : settings_(settings) {}

    // At the programme's iterate, whose slacks and limits' multipliers begin from nothing; with the first weight of the
    // end condition in the factorisation.
    NewtonState begin(std::shared_ptr<Programme> programme, double augmentation) const;
    // At all that the programme holds, with this barrier parameter; free: steps choose the next ones.
    NewtonState resume(std::shared_ptr<Programme> programme, double augmentation, double barrier, bool is_free) const;
    // A step that the filter accepts, with the smallest shift that allows one; or a relaxed step. Where something else
    // has to change first, the step begins anew: docs/solver.md draws what leads where.
    NewtonState step(NewtonState state) const;
    // How it has ended, if it has: residual and increment both below the tolerance, or arrived as far as round-off lets
    // it.
    std::optional<Status> status(const NewtonState& state) const;
    // All steps to the end.
    NewtonState run(NewtonState state) const;

    // What multipliers times distances come to in the end: a part of the tolerance, all of them together.
    double last_barrier(const Programme& programme) const;

    // Whether the residual is so small that the last barrier parameter is taken.
    bool is_near(const NewtonState& state) const { return state.evaluation.residual <= 100.0 * settings_.tolerance; }

    // The barrier parameter as low as the iterate allows; a new one starts a new filter. Where steps choose it, that is
    // left to them while they make progress.
    void update_barrier(NewtonState& state) const;
    // One that falls by the rule from now on; for good if the first step was in trouble.
    void fix_barrier(NewtonState& state) const;
    // A larger last one, where the system is singular. A limit with the multiplier z adds z^2 / mu to the Hessian.
    // Where that is 1e16 times the curvature of a small cost, round-off leaves nothing of the latter. The tolerance,
    // relative to a cost above one, is the largest last one: each product of a multiplier and its distance is below it,
    // if not all of them together.
    void raise_barrier(NewtonState& state) const;

private:
    enum class Next { done, anew, larger_shift };
    // The system with one shift; no direction where the inertia is not a minimum's, or a larger shift is to be tried.
    struct Tried {
        double shift;
        Factorisation factorisation;
        std::optional<CappedDirection> direction;
    };

    void explain_gradient(NewtonState& state) const;
    bool sweep_multipliers(NewtonState& state) const;

    bool predicts(const NewtonState& state) const;
    double least_of(const NewtonState& state) const;
    double highest_barrier(const NewtonState& state) const;
    bool recentre(NewtonState& state) const;
    Direction aim(NewtonState& state) const;

    Care care_of(const NewtonState& state) const;
    void choose_barrier(NewtonState& state) const;
    void sharpen(NewtonState& state) const;
    Tried linearise(NewtonState& state, double shift) const;
    Next find_step(NewtonState& state) const;
    Next follow(NewtonState& state, const Tried& tried, const Care& care, bool is_last) const;
    Next rescue(NewtonState& state, const Tried& tried, bool is_last) const;
    Next arrive(NewtonState& state, const Tried& tried) const;
    void accept(NewtonState& state, const Tried& tried, const StepLength& found) const;
    Next give_up(NewtonState& state, const Factorisation& last, bool is_singular) const;
    void restart_multipliers(NewtonState& state) const;
    bool restore_feasibility(NewtonState& state, double shift) const;
    void relax(NewtonState& state) const;
    void move_unjudged(NewtonState& state, const Tried& tried) const;
    void go_back(NewtonState& state, const Reference& reference) const;

    NewtonSettings settings_;
};

}  // namespace mbocp
