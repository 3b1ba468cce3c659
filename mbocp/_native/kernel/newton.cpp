#include "newton.hpp"

#include "stopping.hpp"
#include "sweeps.hpp"

namespace mbocp {

namespace {

constexpr int careful_after = 200;  // iterations in a run: most take less, and those that take more follow a valley
constexpr int most_restarts = 2;
constexpr double least_shift = 1e-6, most_shift = 1e10;  // a larger least one makes many short steps along flat valleys
constexpr double far = 0.1;           // of a step: where the cap leaves less, a larger shift is tried first
constexpr double last_resort = 1e-9;  // the step may become as short as this
constexpr double relaxed_step = 0.1;  // a step shorter than this is an occasion for relaxed ones
constexpr int relaxed_steps = 6;      // in a run: about as many as it takes to make up for a bent constraint
constexpr double promising = 0.5;     // of the residual: a relaxed step that leaves no more may be followed by another
constexpr int pause = 10;             // steps after a run that led nowhere, before the next
constexpr double restored = 0.5;      // of the violation: what a sweep has to leave at most

constexpr double stiff = 100.0;       // shift with which a step gives multipliers that fit, hardly moving the states
constexpr double explained = 0.2;     // of the gradient: what they may leave
constexpr double most_adjoint = 1e8;  // of a backward sweep that is worth starting from

constexpr double barrier_by_cost = 0.1;  // initial sum of mu over all limits, by the cost of the guess ...
constexpr double least_first = 1e-5, most_first = 1.0;  // ... within these
constexpr double margin = 0.1;  // first distance of a slack from its bounds, relative to them and to their gap
constexpr double share = 0.1;   // of the tolerance, for what multipliers times distances come to in the end
constexpr double rise = 10.0;   // from one last barrier to the next
constexpr int slow = 12;        // iterations with one mu, after which it falls earlier, and less

double largest(const Numbers& values) {
    double found = 0.0;
    for (const double value : values) found = std::abs(value) > found ? std::abs(value) : found;
    return found;
}

bool has_multipliers(const Programme& programme) {
    return largest(programme.iterate.m) > 0.0 || largest(programme.iterate.eta) > 0.0;
}

void clear_multipliers(Programme& programme) {
    std::fill(programme.iterate.m.begin(), programme.iterate.m.end(), 0.0);
    std::fill(programme.iterate.eta.begin(), programme.iterate.eta.end(), 0.0);
}

Factorisation factorise(const NewtonState& state, double shift) {
    return factorise_well(*state.programme, shift, state.augmentation);
}

// After a step.
void advance(NewtonState& state, const Evaluation& e, double increment, double step_length) {
    const double before = state.evaluation.residual;
    state.contraction = step_length == 1.0 && before > 0.0 ? e.residual / before : NewtonState::infinite;
    state.evaluation = e;
    ++state.iteration;
    state.increment = increment, state.step_length = step_length;
    state.failure = e.finite ? std::nullopt : std::make_optional(Status::diverged);
}

// After a change of the barrier parameter, which the programme has.
void take_barrier(NewtonState& state, const Evaluation& e, const Filter& filter) {
    state.barrier = state.programme->barrier.parameter(), state.barrier_since = state.iteration;
    state.evaluation = e, state.filter = filter;
    state.reference.reset();
}

void weigh(NewtonState& state, double barrier) {
    const Evaluation e = state.programme->weigh(barrier);
    take_barrier(state, e, start_filter(*state.programme, e));
}

}  // namespace

double first_barrier(Programme& programme) {
    if (programme.barrier.empty()) return 0.0;
    programme.barrier.start(programme.iterate, least_first, margin);
    const int count = programme.barrier.limits().num_inequalities();
    double parameter = 0.0;
    if (count > 0) {
        const double wanted = barrier_by_cost * std::abs(programme.evaluate(1.0).cost) / count;
        parameter = std::isfinite(wanted) ? std::min(std::max(wanted, least_first), most_first) : most_first;
    }
    programme.barrier.start(programme.iterate, parameter, margin);
    return parameter;
}

NewtonState Newton::begin(std::shared_ptr<Programme> programme, double augmentation) const {
    const double parameter = first_barrier(*programme);
    NewtonState state = resume(std::move(programme), augmentation, parameter, parameter > 0.0);
    if (parameter == 0.0) explain_gradient(state);
    return state;
}

NewtonState Newton::resume(std::shared_ptr<Programme> programme, double augmentation, double barrier,
                           bool is_free) const {
    NewtonState state;
    state.programme = std::move(programme);
    state.evaluation = state.programme->evaluate(1.0);
    state.filter = start_filter(*state.programme, state.evaluation);
    state.augmentation = augmentation;
    if (!state.evaluation.finite) state.failure = Status::diverged;
    state.barrier = barrier;
    if (is_free) state.centring.emplace(barrier, state.filter);
    return state;
}

// Multipliers that leave least of the gradient, where they explain most of it: then they know the curvature that
// turning bodies add to the Hessian. On drones that took a fifth of the iterations, on arms and legs, where they leave
// more, it cost some.
void Newton::explain_gradient(NewtonState& state) const {
    Programme& programme = *state.programme;
    const bool is_curved = programme.problem.nx != programme.problem.ndx;
    if (!is_curved || state.failure || has_multipliers(programme)) return;
    const Factorisation f = factorise(state, stiff * settings_.control_weight);
    if (!f.ok || !programme.riccati.solve(1).finite) return;
    programme.iterate.m = programme.riccati.direction().dm;
    programme.iterate.eta = programme.riccati.direction().deta;
    const Evaluation e = programme.evaluate(1.0);
    if (e.finite && e.dual <= explained * state.evaluation.dual) {
        state.evaluation = e, state.augmentation = f.augmentation;
        return;
    }
    clear_multipliers(programme);
    state.evaluation = programme.evaluate(1.0);
}

// Multipliers of a backward sweep, for a first iterate that has none; false where it has some, or the sweep explodes.
// With multipliers zero the first Hessian knows nothing of the dynamics' curvature. Often that is the better start;
// where it leads to a short step, it is not.
bool Newton::sweep_multipliers(NewtonState& state) const {
    Programme& programme = *state.programme;
    if (state.iteration > 0 || has_multipliers(programme)) return false;
    const Kept kept(programme);
    Evaluation e = programme.gradient(false, false);
    if (e.finite) e = find_end_multiplier(programme, false, false);
    const double size = largest(programme.iterate.m);
    if (e.finite && size > 0.0 && size < most_adjoint) {
        state.evaluation = programme.evaluate(1.0);
        return true;
    }
    kept.restore(programme);
    programme.evaluate(1.0);
    return false;
}

NewtonState Newton::run(NewtonState state) const {
    while (!status(state)) state = step(std::move(state));
    return state;
}

std::optional<Status> Newton::status(const NewtonState& state) const {
    if (state.failure) return state.failure;
    const double residual = state.evaluation.residual, tolerance = settings_.tolerance;
    if (residual <= tolerance && state.increment <= tolerance) return Status::converged;
    if (residual <= settings_.rough || has_arrived(state, tolerance)) return Status::converged;
    return state.iteration >= settings_.max_iterations ? std::make_optional(Status::max_iterations) : std::nullopt;
}

NewtonState Newton::step(NewtonState state) const {
    for (;;) {
        choose_barrier(state);
        if (state.reference) {
            relax(state);
            return state;
        }
        if (find_step(state) == Next::done) return state;
    }
}

Care Newton::care_of(const NewtonState& state) const {
    if (state.barrier > 0.0) return Care::bold();  // limits cut steps whatever the shift
    if (settings_.is_careful || state.iteration >= careful_after) return Care::careful();
    return state.falls_fast ? Care::fast() : Care::bold();
}

// It falls where the iterate allows it, or rises where round-off hides the smallest curvature.
void Newton::choose_barrier(NewtonState& state) const {
    // It may have risen at an iterate of a huge cost.
    state.least_barrier = std::min(state.least_barrier, highest_barrier(state));
    if (state.barrier > 0.0) update_barrier(state);
    if (state.least_barrier > 0.0 && state.shift > 0.0 && !state.reference) sharpen(state);
}

// The barrier rises while the system is singular without a shift; else it is tried without the shift.
void Newton::sharpen(NewtonState& state) const {
    const Tried tried = linearise(state, 0.0);
    if (!tried.factorisation.ok)
        raise_barrier(state);
    else if (tried.direction)
        state.shift = 0.0;
}

// Tries one shift after another until one allows a step.
Newton::Next Newton::find_step(NewtonState& state) const {
    const Care care = care_of(state);
    double shift = state.shift;
    for (int attempts = 0;; ++attempts) {
        Tried tried = linearise(state, shift);
        const bool is_indefinite = !tried.direction;
        // Slacks follow with a step, and one step may be enough to leave what is singular.
        if (!tried.factorisation.ok && shift == 0.0) raise_barrier(state);
        // Nothing is left of a step of hundreds of radians; a larger shift makes a shorter one.
        if (shift > 0.0 && tried.direction && tried.direction->cap < far && attempts <= care.patience)
            tried.direction.reset();
        if (tried.direction) {
            const Next next = follow(state, tried, care, attempts >= care.patience);
            if (next != Next::larger_shift) return next;
        }
        shift = is_indefinite ? care.regrown_shift(shift, state.last_shift, least_shift)
                              : care.larger_shift(shift, least_shift);
        if (shift > most_shift) return give_up(state, tried.factorisation, is_indefinite);
    }
}

// The direction with a shift, and the barrier that it is for, if it chooses that.
Newton::Tried Newton::linearise(NewtonState& state, double shift) const {
    Programme& programme = *state.programme;
    const bool is_aimed = predicts(state);
    if (is_aimed) programme.aim(0.0, false);
    Tried tried{shift, factorise(state, shift * settings_.control_weight), std::nullopt};
    ++state.factorisations;
    if (!(tried.factorisation.ok && tried.factorisation.negative == programme.problem.ng)) {
        if (is_aimed) programme.aim(state.barrier, false);
        return tried;
    }
    const Direction d = is_aimed ? aim(state) : programme.riccati.solve(1);
    if (d.finite) tried.direction = CappedDirection::of(d, state.may_stop());
    return tried;
}

// Goes along a direction as far as the filter lets it. `is_last`: larger shifts have been tried in vain.
Newton::Next Newton::follow(NewtonState& state, const Tried& tried, const Care& care, bool is_last) const {
    const StepLength found = search(*state.programme, state.filter, state.evaluation, *tried.direction,
                                    is_last ? last_resort : care.min_step, state.may_stop());
    if (found.is_corrected) ++state.corrections;
    if (tried.direction->relative(found.length) < relaxed_step) {
        const Next next = rescue(state, tried, is_last);
        if (next != Next::larger_shift) return next;
    }
    if (found.length == 0.0) return arrive(state, tried);
    accept(state, tried, found);
    return Next::done;
}

// Does something about a short step; `larger_shift`: it is taken, or a larger shift is.
Newton::Next Newton::rescue(NewtonState& state, const Tried& tried, bool is_last) const {
    if (predicts(state)) {  // a barrier that was foreseen is the first to be doubted, ...
        fix_barrier(state);
        return Next::anew;
    }
    if (sweep_multipliers(state)) return Next::anew;  // ... then multipliers that begin at zero
    if (!is_last) return Next::larger_shift;
    // Where equations bend away, no line search goes on: steps that nobody judges may, or a sweep.
    if (state.patience == 0 && !state.evaluation.is_feasible()) {
        state.reference = Reference{std::make_shared<Kept>(*state.programme), state.evaluation, relaxed_steps};
        state.shift = tried.shift;
        relax(state);
        return Next::done;
    }
    return restore_feasibility(state, tried.shift) ? Next::done : Next::larger_shift;
}

// The state as it is where only round-off keeps the filter from accepting a step.
Newton::Next Newton::arrive(NewtonState& state, const Tried& tried) const {
    const double increment = tried.direction->increment, tolerance = settings_.tolerance;
    if (increment <= tolerance && state.evaluation.residual <= tolerance) {  // round-off hides any decrease
        state.increment = increment;
        return Next::done;
    }
    if (tried.shift == 0.0 && leads_no_farther(state, increment, tolerance)) {
        state.increment = increment, state.still = many_still;
        return Next::done;
    }
    return Next::larger_shift;
}

void Newton::accept(NewtonState& state, const Tried& tried, const StepLength& found) const {
    const CappedDirection& direction = *tried.direction;
    state.programme->accept(found.length * direction.longest, direction.longest_dual);
    const Evaluation e = state.programme->evaluate(1.0);
    const double shift = tried.shift;
    if (!found.by_cost) state.filter = state.filter.with_corner(state.evaluation);
    state.still = shift > 0.0 ? 0 : stillness(state, e, direction.increment);
    const double length = direction.relative(found.length) * (shift > 0.0 ? direction.cap : 1.0);
    const bool was_enough = shift == state.shift && state.falls_fast;
    if (state.iteration == 0) state.began_large = Care::is_large(shift);
    state.falls_fast = length == 1.0 && (was_enough || (state.began_large && Care::is_large(shift)));
    state.shift = care_of(state).next_shift(shift, length, e.residual / state.evaluation.residual, least_shift);
    state.augmentation = tried.factorisation.augmentation;
    state.regularisation = shift;
    if (shift > 0.0) state.last_shift = shift;
    state.patience = std::max(0, state.patience - 1);
    state.at_minimum = shift == 0.0;
    advance(state, e, direction.increment, found.length * direction.longest);
}

// No shift allows a step: the barrier is fixed, or the multipliers begin anew; or it has failed.
Newton::Next Newton::give_up(NewtonState& state, const Factorisation& last, bool is_singular) const {
    if (state.is_free()) {
        fix_barrier(state);
        return Next::anew;
    }
    if (state.restarts < most_restarts) {
        restart_multipliers(state);
        return Next::anew;
    }
    state.failure = is_singular ? Status::singular : Status::line_search_failed;
    state.failed_stage = last.bad_stage;
    return Next::done;
}

// The motion stays, with multipliers that know nothing of the way there.
void Newton::restart_multipliers(NewtonState& state) const {
    Programme& programme = *state.programme;
    clear_multipliers(programme);
    if (!programme.barrier.slack.empty()) programme.barrier.start(programme.iterate, state.barrier, 1e-2);
    state.evaluation = programme.evaluate(1.0);
    state.shift = 0.0;
    state.filter = start_filter(*state.programme, state.evaluation);
    ++state.restarts;
}

// Sweeps along the iterate; false, with the iterate back, if that is no gain. What remains of the violation is the end
// condition's.
bool Newton::restore_feasibility(NewtonState& state, double shift) const {
    if (state.evaluation.is_feasible()) return false;
    Programme& programme = *state.programme;
    const Kept kept(programme);
    const SweepOutcome swept = sweep(programme, false, true);
    if (swept.evaluation.finite && swept.evaluation.violation < restored * state.evaluation.violation) {
        const Evaluation e = programme.evaluate(1.0);
        if (state.filter.accepts_after_relaxation(state.evaluation, e)) {
            state.filter = state.filter.with_corner(state.evaluation);
            state.regularisation = shift, state.shift = 0.0, state.patience = pause;
            advance(state, e, NewtonState::infinite, 0.0);
            return true;
        }
    }
    kept.restore(programme);
    programme.evaluate(1.0);
    linearise(state, shift);  // the programme holds the direction again
    return false;
}

// Takes one full step that nobody judges; a run of them ends in progress, or is undone.
void Newton::relax(NewtonState& state) const {
    const Reference reference = *state.reference;
    Tried tried = linearise(state, state.shift);
    while (!tried.direction && tried.shift <= most_shift)
        tried = linearise(state, Care::bold().larger_shift(tried.shift, least_shift));
    if (!tried.direction) return go_back(state, reference);
    NewtonState after = state;
    move_unjudged(after, tried);
    if (state.filter.accepts_after_relaxation(reference.evaluation, after.evaluation)) {
        after.reference.reset();
        after.filter = state.filter.with_corner(reference.evaluation);
        state = std::move(after);
    } else if (!after.failure && after.reference->steps_left > 0) {
        state = std::move(after);
    } else {
        go_back(state, reference);
    }
}

// A full step; another one may follow while there are steps left, or this one is promising.
void Newton::move_unjudged(NewtonState& state, const Tried& tried) const {
    const CappedDirection& direction = *tried.direction;
    Programme& programme = *state.programme;
    programme.move(direction.longest);
    programme.accept(direction.longest, direction.longest_dual);
    const Evaluation e = programme.evaluate(1.0);
    const double ratio = e.residual / state.evaluation.residual, shift = tried.shift;
    const bool is_promising = e.residual < promising * state.evaluation.residual;
    state.augmentation = tried.factorisation.augmentation;
    state.regularisation = shift, state.shift = Care::bold().next_shift(shift, 1.0, ratio, least_shift);
    state.reference->steps_left = std::max(state.reference->steps_left - 1, is_promising ? 1 : 0);
    state.at_minimum = shift == 0.0;
    advance(state, e, direction.increment, direction.longest);
}

void Newton::go_back(NewtonState& state, const Reference& reference) const {
    reference.kept->restore(*state.programme);
    state.evaluation = state.programme->evaluate(1.0);
    ++state.iteration;
    state.increment = NewtonState::infinite, state.step_length = 0.0;
    state.reference.reset();
    state.patience = pause;
}

double Newton::last_barrier(const Programme& programme) const {
    return share * settings_.tolerance / std::sqrt(std::max(1, programme.barrier.limits().num_inequalities()));
}

double Newton::least_of(const NewtonState& state) const {
    return std::max(last_barrier(*state.programme), state.least_barrier);
}

// Whether the next step chooses its barrier parameter; with a small residual it is the last one.
bool Newton::predicts(const NewtonState& state) const { return state.is_free() && !is_near(state); }

void Newton::update_barrier(NewtonState& state) const {
    if (state.centring && !state.reference && recentre(state)) return;
    const bool is_slow = state.iteration - state.barrier_since > slow;
    const Evaluation e = lower_barrier(*state.programme, state.evaluation, least_of(state), is_slow);
    if (state.programme->barrier.parameter() != state.barrier)
        take_barrier(state, e, start_filter(*state.programme, e));
}

// Barrier parameters free or fixed, as the last step suggests; a free one may be the last. Whether they are free now.
bool Newton::recentre(NewtonState& state) const {
    if (state.is_free() && !predicts(state)) {
        const double last = least_of(state);
        if (state.barrier != last) take_barrier(state, state.programme->weigh(last), state.filter.without_corners());
        return true;
    }
    const bool was_free = state.centring->is_free();
    const bool is_newtons = state.regularisation == 0.0 && state.step_length == 1.0 && state.shift == 0.0;
    Centring after = *state.centring;
    after.update(state.evaluation.residual, state.barrier, is_newtons);
    if (was_free && !after.is_free()) {
        fix_barrier(state);
        return false;
    }
    if (!was_free && after.is_free()) state.filter = after.bounds();
    state.centring = after;
    return after.is_free();
}

void Newton::fix_barrier(NewtonState& state) const {
    const double barrier = state.centring->fixed_barrier(state.programme->barrier.mean_product(0.0, 0.0));
    if (state.iteration > 0)
        state.centring->fix();
    else
        state.centring.reset();
    weigh(state, std::max(barrier, least_of(state)));
}

// The barrier parameter that a step without barrier suggests, and the step with that. The programme holds a
// factorisation, made with no barrier in the right-hand side.
Direction Newton::aim(NewtonState& state) const {
    Programme& programme = *state.programme;
    const Direction found = programme.riccati.solve_motion();
    if (!found.finite) {
        programme.aim(state.barrier, false);
        return found;
    }
    const Barrier& barrier = programme.barrier;
    const double wanted =
        Centring::aimed_barrier(barrier.mean_product(0.0, 0.0), barrier.mean_product(1.0, found.longest_dual));
    const double least = std::max(state.centring->least_barrier(state.evaluation.barrier_error), least_of(state));
    const double before = state.barrier, aimed = std::max(wanted, least);
    state.evaluation = programme.aim(aimed, Centring::may_correct(found.longest));
    state.barrier = aimed, state.barrier_since = state.iteration;
    if (aimed != before) state.filter = state.filter.without_corners();
    return programme.riccati.solve(1);
}

// To which it may rise: products of multipliers and distances are parts of what the cost may still fall by.
double Newton::highest_barrier(const NewtonState& state) const {
    return settings_.tolerance * std::max(1.0, std::abs(state.evaluation.cost));
}

void Newton::raise_barrier(NewtonState& state) const {
    const double barrier = std::min(rise * state.barrier, highest_barrier(state));
    if (barrier <= state.barrier) return;
    state.centring.reset();
    state.least_barrier = barrier;
    const int since = state.barrier_since;
    weigh(state, barrier);
    state.barrier_since = since;
}

}  // namespace mbocp
