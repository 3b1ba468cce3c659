#include "stopping.hpp"

#include <cstdint>

namespace mbocp {

namespace {

constexpr double grain = 8.0 * 0x1p-52;
// Of terms: each is what hundreds of operations on links come to, and all of them round. Chains of 8 and 16 links leave
// between 0.5 and 120 times the machine's precision.
constexpr double grain_of_terms = 256.0 * 0x1p-52;
// Times that, after many steps that lead nowhere: robots on four legs leave up to 1900 times the precision.
constexpr double most_of_terms = 8.0;
constexpr int long_still = 2 * many_still;
constexpr double moved = 0x1p-36;     // of the unknowns: far above round-off, and so little that all is linear in it
constexpr double of_gradient = 1e-4;  // of the cost: what may be left of stationarity, however large multipliers are

constexpr double stall = 0.5;             // far above round-off, Newton's method leaves less of residual and increment
constexpr double stall_in_limits = 0.05;  // the same of increments there, which vary more where they are round-off
constexpr double resolved = 1e-2;         // of the tolerance, for the residual, ...
constexpr double at_rest = 1e-3;  // of the tolerance, for the residual before a step that is not worth taking, ...
constexpr double foreseen = 0.1;  // ... and for that step, which is foreseen to a few per cent, ...
constexpr double foreseen_of_unknowns = 1e-3;  // ... or relative to the unknowns: long horizons have large norms
constexpr double noise = 1e3;  // ... and times the tolerance, for increments that do not shrink any more

double larger(const Sizes& sizes) { return std::max(sizes.primal, sizes.dual); }

// Norm of what was added to a vector, at a right angle as random signs have it.
double growth(double before, double after) {
    return std::isfinite(after) ? std::sqrt(std::max(0.0, after * after - before * before)) : 0.0;
}

// What round-off may leave of the residual: by the terms themselves where steps have led no farther, and more
// of them the longer that goes on.
Sizes allowed(const NewtonState& state) {
    Programme& programme = *state.programme;
    if (state.still < many_still) return round_off(programme);
    const Sizes terms = round_off_of_terms(programme, state.evaluation);
    const double share = state.still < long_still ? 1.0 : most_of_terms;
    return {share * terms.primal, share * terms.dual};
}

bool is_resolved(const Programme& programme, double primal, double dual, double increment, double tolerance,
                 const Sizes& allowed) {
    return std::isfinite(increment) && larger(allowed) > tolerance &&
           relative_residual(allowed, primal, dual, tolerance) <= tolerance &&
           relative_increment(programme) <= tolerance;
}

// Whether the residual is far below the tolerance, or about round-off, and an increment may be that, too. The longer
// the horizon, the larger the norms of residual, increment and unknowns. With limits the barrier leaves something of
// the residual by construction, which does not count.
bool is_round_off(const NewtonState& state, double increment, double tolerance) {
    const Evaluation& e = state.evaluation;
    if (e.residual > tolerance) return false;
    const double shrunk = state.still >= many_still ? noise : 1.0;  // increments that shrink no more are what they are
    if (increment > noise * tolerance && relative_increment(*state.programme) > shrunk * tolerance) return false;
    const double left = state.barrier > 0.0 ? e.barrier_error : e.residual;
    return left <= resolved * tolerance || left <= larger(allowed(state));
}

// Whether residual and increments are round-off, which no step makes less. With limits multipliers are sums of many
// others where limits are active from end to end, and jump though the motion rests.
bool is_noise(const NewtonState& state, double tolerance) {
    const bool is_still = state.still >= many_still;
    if (!std::isfinite(state.increment)) return false;  // before the first step
    if (!(is_still || state.barrier > 0.0) || !is_round_off(state, state.increment, tolerance)) return false;
    const Increment& direction = state.programme->riccati.direction();
    return is_still || (norm({&direction.dx}) <= tolerance && norm({&direction.du}) <= tolerance);
}

// Whether all conditions hold with the least barrier that round-off allows, not with the last one.
bool is_centred(const NewtonState& state, double tolerance) {
    return state.least_barrier > 0.0 && state.barrier == state.least_barrier &&
           state.evaluation.barrier_error <= resolved * tolerance && state.increment <= noise * tolerance;
}

bool rests(const NewtonState& state, double tolerance) {
    const Programme& programme = *state.programme;
    const double residual = state.evaluation.residual;
    if (!std::isfinite(state.next_increment()) || residual > tolerance) return false;
    return is_at_rest(residual, larger(round_off(programme)), state.next_increment(),
                      state.contraction * relative_increment(programme), tolerance);
}

}  // namespace

Sizes round_off(const Programme& programme) {
    const Sizes sizes = programme.sizes();
    return {grain * sizes.primal, grain * sizes.dual};
}

Sizes round_off_of_terms(Programme& programme, const Evaluation& e) {
    const Kept kept(programme);
    std::uint64_t signs = 0x9E3779B97F4A7C15u;
    Iterate& at = programme.iterate;
    for (Numbers* values : {&at.x, &at.y, &at.u, &at.m, &at.eta})
        for (double& value : *values) {
            signs ^= signs << 13, signs ^= signs >> 7, signs ^= signs << 17;  // xorshift
            value *= signs >> 63 ? 1.0 + moved : 1.0 - moved;
        }
    const Evaluation after = programme.evaluate(1.0);
    kept.restore(programme);
    programme.evaluate(1.0);
    const Sizes least = round_off(programme);
    const double share = grain_of_terms / moved;
    return {std::max(least.primal, share * growth(e.primal, after.primal)),
            std::max(least.dual, share * growth(e.dual, after.dual))};
}

double relative_residual(const Sizes& allowed, double primal, double dual, double tolerance) {
    return std::hypot(primal / std::max(1.0, allowed.primal / tolerance),
                      dual / std::max(1.0, allowed.dual / tolerance));
}

double relative_increment(const Programme& programme) {
    const Iterate& at = programme.iterate;
    const Increment& step = programme.riccati.direction();
    return std::hypot(norm({&step.dx}) / std::max(1.0, norm({&at.x})),
                      norm({&step.dy, &step.du}) / std::max(1.0, norm({&at.y, &at.u})),
                      norm({&step.dm, &step.deta}) / std::max(1.0, norm({&at.m, &at.eta})));
}

bool has_a_say(Programme& programme, double dual) {
    const Kept kept(programme);
    for (Numbers* values :
         {&programme.iterate.m, &programme.iterate.eta, &programme.barrier.z_lower, &programme.barrier.z_upper})
        std::fill(values->begin(), values->end(), 0.0);
    const double gradient = programme.evaluate(1.0).dual;
    kept.restore(programme);
    programme.evaluate(1.0);
    return dual <= of_gradient * gradient;
}

bool is_resolved(const Programme& programme, double primal, double dual, double increment, double tolerance) {
    return is_resolved(programme, primal, dual, increment, tolerance, round_off(programme));
}

bool is_at_rest(double residual, double allowed, double coming, double relative, double tolerance) {
    return residual <= std::max(at_rest * tolerance, allowed) &&
           (coming <= foreseen * tolerance || relative <= foreseen_of_unknowns * tolerance);
}

bool is_within_round_off(const NewtonState& state, double tolerance) {
    Programme& programme = *state.programme;
    const Evaluation& e = state.evaluation;
    const auto resolves = [&](const Sizes& sizes) {
        return is_resolved(programme, e.primal, e.dual, state.increment, tolerance, sizes);
    };
    if (state.still < many_still && !resolves(round_off(programme))) return false;  // the quickest of the questions
    if (relative_increment(programme) > tolerance || !resolves(allowed(state))) return false;
    return has_a_say(programme, e.dual);
}

bool has_arrived(const NewtonState& state, double tolerance) {
    return is_noise(state, tolerance) || is_centred(state, tolerance) || rests(state, tolerance) ||
           is_within_round_off(state, tolerance);
}

bool leads_no_farther(NewtonState state, double increment, double tolerance) {
    state.increment = increment, state.still = many_still;
    return is_round_off(state, increment, tolerance) || is_within_round_off(state, tolerance);
}

int stillness(const NewtonState& state, const Evaluation& e, double increment) {
    const double least = (state.barrier > 0.0 ? stall_in_limits : stall) * state.increment;
    return e.residual > stall * state.evaluation.residual && increment > least ? state.still + 1 : 0;
}

}  // namespace mbocp
