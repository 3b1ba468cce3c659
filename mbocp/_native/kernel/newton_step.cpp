#include "newton_step.hpp"

#include <cmath>

namespace mbocp {

namespace {

constexpr double most_turn = 1.0;  // of a joint in one step [rad]
// Relative eigenvalue of eta's Schur complement below which the end condition is augmented more.
constexpr double least_end_condition = 1e-3, most_augmentation = 1e12, augmentation_growth = 100.0;
// Violation that is worth a correction, by the iterate's, or in all: a step that went far astray is beyond it.
constexpr double correctable = 30.0, nearly = 0.1;
// The barrier falls where the defect of its problem is below this multiple of it, by a factor or to a power.
constexpr double settled = 30.0, power = 1.7, slow_settled = 300.0, slow_power = 1.2, factor = 0.1;

bool is_correctable(const Trial& before, const Trial& trial) {
    return trial.finite && before.violation <= trial.violation &&
           trial.violation <= std::max(correctable * before.violation, nearly);
}

}  // namespace

CappedDirection CappedDirection::of(const Direction& d, bool may_stop) {
    CappedDirection out;
    out.increment = d.increment, out.slope = d.slope, out.longest_dual = d.longest_dual;
    out.cap = d.turn > 0.0 ? std::min(1.0, most_turn / d.turn) : 1.0;
    out.longest = may_stop ? out.cap : std::min(d.longest, out.cap);
    if (may_stop) out.limit = std::min(1.0, d.longest / out.cap);
    return out;
}

Factorisation factorise_well(Programme& programme, double shift, double augmentation) {
    const Problem& p = programme.problem;
    for (;;) {
        Factorisation f = programme.riccati.factorise(shift, augmentation);
        f.augmentation = augmentation;
        const bool is_end_singular = f.bad_stage == p.N;
        const bool is_indefinite = f.negative > p.ng;  // whatever the augmentation
        const bool is_ill_conditioned = f.ok && !is_indefinite && f.end_condition < least_end_condition;
        if (!(is_end_singular || is_ill_conditioned) || augmentation == 0.0 || augmentation >= most_augmentation)
            return f;
        augmentation *= augmentation_growth;
    }
}

Filter start_filter(const Programme& programme, const Trial& first) {
    return Filter::start(first.violation, !programme.barrier.empty());
}

StepLength search(Programme& programme, const Filter& filter, const Trial& before, const CappedDirection& direction,
                  double shortest, bool may_stop) {
    const double longest = direction.longest;
    const auto judge = [&](const Trial& trial, double length) -> Verdict {
        if (length > direction.limit && !(trial.violation < before.violation)) return {};
        return filter.accepts(before, trial, direction.slope, length * longest);
    };
    StepLength found;
    for (double length = 1.0; length >= shortest; length = direction.shorter(length)) {
        Trial trial = programme.trial(length * longest);
        Verdict verdict = judge(trial, length);
        if (!verdict.is_accepted && length == 1.0 && is_correctable(before, trial)) {
            // The corrected direction replaces the plain one in the kernel ...
            const CappedDirection corrected = CappedDirection::of(programme.correct(longest), may_stop);
            trial = programme.trial(std::min(longest, corrected.longest));
            verdict = judge(trial, 1.0);
            found.is_corrected = true;
            if (!verdict.is_accepted) programme.riccati.solve(1);  // ... which is had again where that does not help
        }
        if (verdict.is_accepted) {
            found.length = length, found.by_cost = verdict.by_cost, found.trial = trial;
            return found;
        }
    }
    return found;
}

Evaluation lower_barrier(Programme& programme, Evaluation e, double least, bool is_slow) {
    double parameter = programme.barrier.parameter();
    while (parameter > least && e.barrier_error <= (is_slow ? slow_settled : settled) * parameter) {
        parameter = std::max(least, std::min(factor * parameter, std::pow(parameter, is_slow ? slow_power : power)));
        e = programme.weigh(parameter);
    }
    return e;
}

}  // namespace mbocp
