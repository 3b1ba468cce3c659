#include "receding.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "newton_step.hpp"
#include "shift.hpp"

namespace mbocp {

namespace {

constexpr Care care = Care::bold();
constexpr double least_shift = 1e-6, most_shift = 1e4;
constexpr int most_attempts = 8;
constexpr double unknown_contraction = 1.0;  // of the residual: the next state is another one
// Factorisations with a wrong inertia after which the Hessian is that of the cost alone: after a jump of the goal no
// shift that is worth trying makes up for the curvature that far multipliers give the dynamics.
constexpr int most_wrong = 4;
// A step that limits cut to less than this raises the barrier parameter, up to a multiple: slacks get room.
constexpr double cut_short = 0.1, barrier_rise = 10.0, barrier_rises = 1e4;
constexpr double room_anew = 0.25;  // of slacks that begin anew: with less limits cut the next steps short again
constexpr double smallest_barrier = 1e-9, largest_barrier = 1.0;
constexpr double whole_step = 1e-9;  // shifts by nearly a whole number of steps are by that number
// Of the duration of Newton steps: how far it follows a shorter and a longer one, which counts as this multiple at
// most.
constexpr double to_shorter = 0.5, to_longer = 0.1, most_longer = 4.0;

double seconds_between(std::chrono::steady_clock::time_point a, std::chrono::steady_clock::time_point b) {
    return std::chrono::duration<double>(b - a).count();
}

}  // namespace

RecedingHorizon::RecedingHorizon(Programme& programme, HorizonSettings settings)
    : programme_(programme), settings_(std::move(settings)), augmentation_(settings_.augmentation),
      barrier_(programme.barrier.parameter()), least_barrier_(barrier_) {
    const Problem& p = programme_.problem;
    rows_move_ = has_same_rows();
    const auto nd = static_cast<std::size_t>(p.ndx), nu = static_cast<std::size_t>(p.kind().nu);
    dx_.assign(nd, 0.0), unit_.assign(nd, 0.0), answer_.assign(nu, 0.0);
    x = programme_.iterate.x, u = programme_.iterate.u;
    gains.assign(static_cast<std::size_t>(p.N) * nu * nd, 0.0);
}

bool RecedingHorizon::has_same_rows() const {
    const Limits& limits = programme_.barrier.limits();
    if (limits.empty()) return true;
    const auto same = [](double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); };
    const auto first = limits.of_stage(0);
    for (int n = 1; n < programme_.problem.N; ++n) {
        const auto rows = limits.of_stage(n);
        if (rows.u - rows.x != first.u - first.x || rows.path - rows.u != first.path - first.u ||
            rows.end - rows.path != first.end - first.path)
            return false;
        for (int i = 0; i < first.end - first.x; ++i) {
            const int a = first.x + i, b = rows.x + i;
            if (limits.entry(a) != limits.entry(b) || !same(limits.lower[a], limits.lower[b]) ||
                !same(limits.upper[a], limits.upper[b]))
                return false;
        }
    }
    return limits.equations.empty();
}

// Stage after stage: what was `whole` stages later, or between that and the one after it. The last one stays.
void RecedingHorizon::move_rows(Numbers& values, std::size_t first, int size, int whole, double part) const {
    const int last = programme_.problem.N - 1;
    double* of = values.data() + first;
    for (int n = 0; n <= last; ++n) {
        const double *a = of + std::min(n + whole, last) * size, *b = of + std::min(n + whole + 1, last) * size;
        for (int i = 0; i < size; ++i) of[n * size + i] = part == 0.0 ? a[i] : (1.0 - part) * a[i] + part * b[i];
    }
}

void RecedingHorizon::move_states(int whole, double part) {
    const Problem& p = programme_.problem;
    double* at = programme_.iterate.x.data();
    for (int n = 0; n <= p.N; ++n) {
        const double *a = at + p.x_offset(std::min(n + whole, p.N)), *b = at + p.x_offset(std::min(n + whole + 1, p.N));
        double* to = at + p.x_offset(n);
        const bool is_between = part != 0.0 && a != b;
        if (is_between && p.difference(a, b, dx_.data()) && p.retract(a, dx_.data(), part, to)) continue;
        if (a != to) std::copy(a, a + p.nx, to);
    }
}

void RecedingHorizon::move_on(double steps) {
    const Problem& p = programme_.problem;
    if (!(steps > 0.0)) return;
    steps = std::min(steps, static_cast<double>(p.N));
    const double nearest = std::round(steps);
    if (std::abs(steps - nearest) < whole_step) steps = nearest;
    const int whole = static_cast<int>(steps);
    const double part = steps - whole;
    const Kind& k = p.kind();
    Iterate& iterate = programme_.iterate;
    move_states(whole, part);
    move_rows(iterate.y, 0, k.ny, whole, part), move_rows(iterate.u, 0, k.nu, whole, part);
    move_rows(iterate.m, 0, k.nc(), whole, part);
    Barrier& barrier = programme_.barrier;
    if (barrier.empty()) return;
    if (!rows_move_) return barrier.start(iterate, barrier_, 1e-3);
    const auto rows = barrier.limits().of_stage(0);
    for (Numbers* values : {&barrier.slack, &barrier.z_lower, &barrier.z_upper})
        move_rows(*values, static_cast<std::size_t>(rows.x), rows.end - rows.x, whole, part);
}

HorizonStatus RecedingHorizon::step(const double* state, int size, double steps, int iterations,
                                    double time_limit) noexcept {
    const auto begun = Clock::now();
    const auto deadline = time_limit < 1e6 ? begun + std::chrono::duration_cast<Clock::duration>(
                                                         std::chrono::duration<double>(std::max(time_limit, 0.0)))
                                           : Clock::time_point::max();
    HorizonStatus status;
    bool is_good_state = true;
    const auto ends = [&](Found found) {
        if (found == Found::not_finite) return status.outcome = Outcome::not_finite, true;
        if (found == Found::singular) return status.outcome = Outcome::stuck, true;
        if (found == Found::none) return status.outcome = is_late_ ? Outcome::out_of_time : Outcome::stuck, true;
        if (status.increment <= settings_.tolerance && barrier_ <= least_barrier_)
            return status.outcome = Outcome::converged, true;
        return false;
    };
    try {
        move_on(steps);
        for (int i = 0; i < size; ++i) is_good_state = is_good_state && std::isfinite(state[i]);
        if (is_good_state) std::copy(state, state + size, programme_.iterate.x.begin());
        if (iterations < 1) status.outcome = Outcome::moved_on;
        for (int i = 0; i < iterations; ++i) {
            const auto before = Clock::now();
            // The first one begins in any case: a step that others on the machine have held up says nothing of it.
            is_late_ = seconds_between(before, deadline) <= (i > 0 ? duration_ : 0.0);
            if (is_late_) {
                status.outcome = Outcome::out_of_time;
                break;
            }
            Found found = newton_step(status, deadline);
            if ((found == Found::none || found == Found::singular) && !is_late_) {
                begin_anew();
                found = newton_step(status, deadline);
            }
            learn_duration(seconds_between(before, Clock::now()));
            if (ends(found)) break;
        }
        copy_out();
    } catch (...) {
        status.outcome = Outcome::not_finite;
    }
    if (!is_good_state) status.outcome = Outcome::bad_state;
    status.barrier = programme_.barrier.empty() ? 0.0 : barrier_, status.shift = shift_;
    status.seconds = seconds_between(begun, Clock::now());
    return status;
}

void RecedingHorizon::learn_duration(double seconds) {
    if (duration_ == 0.0) duration_ = seconds;
    const double counted = std::min(seconds, most_longer * duration_);
    duration_ += (counted < duration_ ? to_shorter : to_longer) * (counted - duration_);
}

RecedingHorizon::Found RecedingHorizon::newton_step(HorizonStatus& status, Clock::time_point deadline) {
    const auto late = [&] { return is_late_ = Clock::now() >= deadline; };
    Evaluation before = programme_.evaluate(1.0);
    if (!before.finite) return Found::not_finite;
    status.violation = before.violation, status.objective = before.objective;
    if (late()) return Found::none;
    if (!programme_.barrier.empty()) adapt_barrier(before);
    bool had_direction = false;
    int wrong = 0;
    double shift = shift_;
    for (int attempt = 0; attempt < most_attempts && shift <= most_shift; ++attempt) {
        const Factorisation f = factorise_well(programme_, shift * settings_.shift_unit, augmentation_);
        augmentation_ = f.augmentation;
        if (late()) return Found::none;
        const bool is_right = f.ok && f.negative == programme_.problem.ng;
        if (!is_right && ++wrong == most_wrong) {
            if (!programme_.evaluate(0.0).finite) return Found::not_finite;
            if (late()) return Found::none;
            shift = 0.0;
            continue;
        }
        if (is_right) {
            const Direction d = programme_.riccati.solve(1);
            if (d.finite) {
                had_direction = true;
                const CappedDirection capped = CappedDirection::of(d, false);
                const StepLength found =
                    search(programme_, start_filter(programme_, before), before, capped, care.min_step, false);
                if (found.length > 0.0) {
                    copy_gains();
                    status.length = found.length * capped.longest, status.increment = d.increment;
                    status.violation = found.trial.violation, status.objective = found.trial.objective;
                    programme_.accept(status.length, capped.longest_dual);
                    shift_ = care.next_shift(shift, found.length, unknown_contraction, least_shift);
                    if (d.longest < cut_short) barrier_ *= barrier_rise;
                    ++status.iterations;
                    return Found::step;
                }
                if (late()) return Found::none;
            }
        }
        shift = is_right ? care.larger_shift(shift, least_shift) : care.regrown_shift(shift, shift_, least_shift);
    }
    return had_direction ? Found::none : Found::singular;
}

// Slacks that limits have jammed and multipliers far from any optimum, as a jump of the goal may leave them, let no
// step improve, now or later: the prediction alone stays.
void RecedingHorizon::begin_anew() {
    Iterate& iterate = programme_.iterate;
    std::fill(iterate.m.begin(), iterate.m.end(), 0.0), std::fill(iterate.eta.begin(), iterate.eta.end(), 0.0);
    if (!programme_.barrier.empty()) programme_.barrier.start(iterate, barrier_, room_anew);
    shift_ = 0.0;
}

// The parameter goes by the cost, which another goal may change by orders of magnitude; it falls as the optimality
// conditions allow.
void RecedingHorizon::adapt_barrier(Evaluation& e) {
    const double wanted =
        settings_.barrier * std::abs(e.cost) / std::max(programme_.barrier.limits().num_inequalities(), 1);
    const double least = least_barrier_ = std::min(std::max(wanted, smallest_barrier), largest_barrier);
    barrier_ = std::min(std::max(barrier_, least), barrier_rises * least);
    e = lower_barrier(programme_, programme_.weigh(barrier_), least, false);
    barrier_ = programme_.barrier.parameter();
}

void RecedingHorizon::copy_out() {
    std::copy(programme_.iterate.x.begin(), programme_.iterate.x.end(), x.begin());
    std::copy(programme_.iterate.u.begin(), programme_.iterate.u.end(), u.begin());
}

void RecedingHorizon::copy_gains() {
    const Problem& p = programme_.problem;
    const std::size_t nd = unit_.size(), nu = answer_.size();
    double* at = gains.data();
    for (int n = 0; n < p.N; ++n, at += nu * nd)
        for (std::size_t j = 0; j < nd; ++j) {
            std::fill(answer_.begin(), answer_.end(), 0.0);
            unit_[j] = 1.0;
            programme_.riccati.elimination().feed_back(n, unit_.data(), answer_.data());
            unit_[j] = 0.0;
            for (std::size_t i = 0; i < nu; ++i) at[i * nd + j] = answer_[i];
        }
}

}  // namespace mbocp
