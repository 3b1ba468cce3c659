#include "barrier.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

constexpr double least_rest = 1e-2;       // of a distance to a bound that a step has to leave: 1 - tau, or mu
constexpr double least_clipped = 1e-4;    // at least, of a distance whose slack stops short of its bound alone
constexpr double most_off_centre = 1e10;  // z (s - lower) / mu stays between this and its inverse
// Of equations, delta by what the controls of the step before do to the row; where that is not known yet, or they do
// nothing, and between which limits, by the square of the row's slope. Smaller ones spoil what is beside the row by
// round-off, with larger ones rows that depend on each other nearly take many steps.
constexpr double delta_by_response = 1e-6, least_delta = 1e-16, most_delta = 1e-7, first_delta = 1e-9;
constexpr double least_slope = 1e-6;   // squared
constexpr double grain = 8 * 0x1p-52;  // of a row's terms: defects below it are round-off
constexpr double repeated = 0.1;       // two passes that differ by less than this part are the same

bool has(double bound) { return std::isfinite(bound); }

using dense::Indices;
using dense::Vec;

constexpr Vec none = {};

Vec all(double value) { return Vec{value, value, value, value}; }
Vec larger(Vec a, Vec b) { return b > a ? b : a; }  // a where b is no number

// As many rows at once as a vector has entries, from `first` on; behind the last of those that are left there are no
// sides, and zeros elsewhere.
struct Rows {
    int first, left;

    Vec of(const Numbers& values) const { return dense::first_of(values.data() + first, left); }
    Vec side(const Numbers& bounds, double infinite) const {
        const long long size = left;
        return Indices{0, 1, 2, 3} < Indices{size, size, size, size} ? of(bounds) : all(infinite);
    }
    void store(Vec from, Numbers& to) const { dense::store_first(to.data() + first, from, left); }
};

// The sides of rows, infinite where there are none.
struct Sides {
    Vec lower, upper;
    Indices has_lower, has_upper;

    Sides(const Limits& limits, const Rows& rows)
        : lower(rows.side(limits.lower, -INFINITY)), upper(rows.side(limits.upper, INFINITY)),
          has_lower(lower > all(-INFINITY)), has_upper(upper < all(INFINITY)) {}
};

template <class Work>
void for_rows(int size, Work work) {
    for (int i = 0; i < size; i += dense::width) work(Rows{i, size - i});
}

// -mu log of the distances, many factors to a logarithm.
struct LogBarrier {
    Vec product = all(1.0);
    double sum = 0.0;
    Indices ok = {-1, -1, -1, -1};

    void add(Indices has, Vec distance) {
        distance = has ? distance : all(1.0);
        ok &= distance > 0.0;
        product *= distance;
        const Indices is_safe = (product >= 1e-200) & (product <= 1e200);
        if (!(is_safe[0] & is_safe[1] & is_safe[2] & is_safe[3])) take_logarithms();
    }
    void take_logarithms() {
        for (int i = 0; i < dense::width; ++i) sum += std::log(product[i]);
        product = all(1.0);
    }
    bool is_ok() const { return ok[0] & ok[1] & ok[2] & ok[3]; }
    double value(double mu) {
        take_logarithms();
        return -mu * sum;
    }
};

}  // namespace

void Barrier::set_limits(const Bounds& bounds, Function path, Function path_values, Function guard) {
    limits_.set(bounds, std::move(path), std::move(path_values), std::move(guard));
    for (Numbers* v : {&slack, &z_lower, &z_upper, &lambda_, &h_, &defect_, &sigma_, &force_, &ds_, &dz_lower_,
                       &dz_upper_, &curved_lower_, &curved_upper_, &slack_moved_})
        v->assign(static_cast<std::size_t>(num_rows()), 0.0);
    for (Numbers* v : {&weight_, &response_, &missed_, &dlambda_, &reach_}) v->assign(limits_.equations.size(), 0.0);

    pass_.assign(limits_.equations.empty() ? 0 : static_cast<std::size_t>(num_rows()), 0.0);
}

Numbers Barrier::multipliers() const {
    Numbers out(z_upper);
    for (std::size_t i = 0; i < out.size(); ++i) out[i] -= z_lower[i];
    return out;
}

bool Barrier::evaluate(const Point& at) {
    for (int i = 0; i < num_rows(); ++i) lambda_[i] = z_upper[i] - z_lower[i];
    const bool ok = limits_.evaluate(at, lambda_, h_);
    for (int i = 0; i < num_rows(); ++i) defect_[i] = h_[i] - slack[i];
    for (std::size_t k = 0; k < reach_.size(); ++k) reach_[k] = limits_.reach(k, at);
    return ok;
}

void Barrier::start(const Point& at, double parameter, double inside) {
    parameter_ = parameter;
    evaluate(at);
    for (int i = 0; i < num_rows(); ++i) {
        const double lower = limits_.lower[i], upper = limits_.upper[i], gap = upper - lower;
        const auto margin = [&](double bound) {
            return std::min(inside * std::max(1.0, std::abs(bound)), inside * gap);
        };
        double s = h_[i];
        if (has(lower)) s = std::max(s, lower + margin(lower));
        if (has(upper)) s = std::min(s, upper - margin(upper));
        slack[i] = s;
        z_lower[i] = has(lower) ? parameter / (s - lower) : 0.0;
        z_upper[i] = has(upper) ? parameter / (upper - s) : 0.0;
    }
    for (const Equation& e : limits_.equations) slack[e.row] = e.value;
}

void Barrier::set_parameter(double parameter) {
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack);
        const Vec below = sides.has_lower ? rows.of(z_lower) / (s - sides.lower) : none;
        rows.store(below + (sides.has_upper ? rows.of(z_upper) / (sides.upper - s) : none), sigma_);
    });
    aim(parameter, false);
    for (std::size_t k = 0; k < weight_.size(); ++k) {
        const double slope = std::max(limits_.squared_slope(k), least_slope);
        const double wanted = response_[k] == 0.0 ? first_delta * slope : delta_by_response * response_[k];
        weight_[k] = 1.0 / std::min(std::max(wanted, least_delta * slope), most_delta * slope);
        sigma_[limits_.equations[k].row] = weight_[k];
    }
    limits_.weigh(sigma_);
}

void Barrier::aim(double parameter, bool is_curved) {
    parameter_ = parameter;
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack), ds = is_curved ? rows.of(ds_) : none;
        const Vec curved_lower = ds * rows.of(dz_lower_), curved_upper = -ds * rows.of(dz_upper_);
        rows.store(curved_lower, curved_lower_), rows.store(curved_upper, curved_upper_);
        const Vec below = sides.has_lower ? (parameter - curved_lower) / (s - sides.lower) : none;
        const Vec above = sides.has_upper ? (parameter - curved_upper) / (sides.upper - s) : none;
        rows.store(above - below + rows.of(sigma_) * rows.of(defect_), force_);
    });
}

void Barrier::finish(Evaluation& e) const {
    LogBarrier barrier;
    Vec squares = {}, errors = {};
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack);
        const auto add = [&](Indices has, Vec distance, Vec z) {
            const Vec product = has ? distance * z : none, error = has ? product - parameter_ : none;
            barrier.add(has, distance);
            squares += product * product, errors = larger(errors, error < 0.0 ? -error : error);
        };
        add(sides.has_lower, s - sides.lower, rows.of(z_lower));
        add(sides.has_upper, sides.upper - s, rows.of(z_upper));
    });
    e.barrier_error = std::max(e.barrier_error, dense::largest_of(errors));
    e.objective = e.cost + barrier.value(parameter_);
    e.complementarity = std::sqrt(dense::sum_of(squares));
    e.dual = std::hypot(e.dual, e.complementarity);
    e.residual = std::hypot(e.primal, e.dual);
    e.finite = e.finite && barrier.is_ok() && std::isfinite(e.residual) && std::isfinite(e.objective);
}

void Barrier::add_to_controls(int n, double* Quu, int ld) const {
    if (empty()) return;
    const Limits::Rows rows = limits_.of_stage(n);
    for (int i = rows.u; i < rows.path; ++i) Quu[limits_.entry(i) * (ld + 1)] += sigma_[i];
}

void Barrier::start_equations() {
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const auto [row, value] = limits_.equations[k];
        missed_[k] = defect_[row];
    }
    begin_equations();
}

void Barrier::start_equations(const Numbers& rhs) {
    std::fill(force_.begin(), force_.end(), 0.0);
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const int row = limits_.equations[k].row;
        missed_[k] = -rhs[k], dlambda_[k] = pass_[row] = 0.0, force_[row] = weight_[k] * missed_[k];
    }
}

double Barrier::missed(const Increment& step) {
    if (missed_.empty()) return 0.0;
    limits_.along(step, ds_);
    double most = 0, all = dense::largest(static_cast<int>(step.dx.size()), step.dx.data());
    double pull = 0, all_pulls = dense::largest(static_cast<int>(dlambda_.size()), dlambda_.data());
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const double ds = ds_[limits_.equations[k].row], miss = std::abs(missed_[k] + ds);
        most = std::max(most, miss), all = std::max({all, std::abs(missed_[k]), std::abs(ds)});
        pull = std::max(pull, weight_[k] * miss);
    }
    const auto share = [](double part, double whole) { return part > 0.0 ? part / whole : 0.0; };
    return std::min(share(most, all), share(pull, all_pulls));
}

void Barrier::correct_equations(double alpha) {
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const auto [row, value] = limits_.equations[k];
        missed_[k] = alpha * defect_[row] + h_[row] - value;
    }
    begin_equations();
}

void Barrier::begin_equations() {
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const auto [row, value] = limits_.equations[k];
        if (std::abs(missed_[k]) <= grain * std::max({1.0, std::abs(value), reach_[k]})) missed_[k] = 0.0;
        dlambda_[k] = pass_[row] = 0.0, force_[row] = z_upper[row] + weight_[k] * missed_[k];
    }
}

Barrier::Passes Barrier::resolve_equations(const Increment& step, const Accuracy& accuracy) {
    limits_.along(step, ds_);
    double change = 0, most = 0, all = 0, difference = 0;
    for (std::size_t k = 0; k < missed_.size(); ++k) {
        const int row = limits_.equations[k].row;
        const double before = pass_[row];
        pass_[row] = weight_[k] * (missed_[k] + ds_[row]);
        dlambda_[k] += pass_[row], difference = std::max(difference, std::abs(pass_[row] - before));
        change = std::max(change, std::abs(pass_[row])), most = std::max(most, std::abs(dlambda_[k]));
        all = std::max(all, std::abs(z_upper[row]));
    }
    if (!(change > accuracy.of_step * most && change > accuracy.of_all * all)) return Passes::enough;
    return difference > repeated * change ? Passes::more : Passes::repeat;
}

void Barrier::learn(int n, const double* T, const double* Hss, int ldt, int nd) {
    const auto [first, last] = limits_.equations_of(n);
    for (int k = first; k < last; ++k) response_[k] = limits_.response(k, T, Hss, ldt, nd);
}

void Barrier::take_back(int passes) {
    for (std::size_t k = 0; k < dlambda_.size(); ++k) {
        double& pass = pass_[limits_.equations[k].row];
        pass *= -passes, dlambda_[k] += pass;
    }
}

void Barrier::find_step(const Increment& step, Direction& d) {
    limits_.along(step, ds_);
    const double mu = parameter_, tau = std::max(1.0 - least_rest, 1.0 - mu);
    Vec losses = {}, declines = {}, slopes = {};  // relative losses of distances, and of multipliers
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack), ds = rows.of(ds_) + rows.of(defect_);
        rows.store(ds, ds_);
        const auto step = [&](Indices has, Vec distance, Vec growth, Vec curved, Vec z, Numbers& dz) {
            const Vec inverse = has ? 1.0 / distance : none;
            const Vec change = has ? (mu - curved - z * growth) * inverse - z : none;
            rows.store(change, dz);
            losses = larger(losses, -growth * inverse), declines = larger(declines, has ? -change / z : none);
            slopes -= mu * inverse * growth;
        };
        step(sides.has_lower, s - sides.lower, ds, rows.of(curved_lower_), rows.of(z_lower), dz_lower_);
        step(sides.has_upper, sides.upper - s, -ds, rows.of(curved_upper_), rows.of(z_upper), dz_upper_);
    });
    const double approach = dense::largest_of(losses), decline = dense::largest_of(declines);
    d.slope += dense::sum_of(slopes);
    for (const Equation& e : limits_.equations) ds_[e.row] = 0.0;
    d.longest = longest_ = approach > tau ? tau / approach : 1.0;
    d.longest_dual = decline > tau ? tau / decline : 1.0;
}

double Barrier::mean_product(double alpha, double alpha_limits) const {
    Vec sums = {}, counts = {};
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack), ds = rows.of(ds_);
        const auto add = [&](Indices has, Vec distance, Vec growth, Vec z, Vec dz) {
            const Vec moved = distance + alpha * growth;
            sums += has ? (moved < 0.0 ? none : moved) * (z + alpha_limits * dz) : none,
                counts += has ? all(1.0) : none;
        };
        add(sides.has_lower, s - sides.lower, ds, rows.of(z_lower), rows.of(dz_lower_));
        add(sides.has_upper, sides.upper - s, -ds, rows.of(z_upper), rows.of(dz_upper_));
    });
    const double count = dense::sum_of(counts);
    return count > 0.0 ? dense::sum_of(sums) / count : 0.0;
}

// Beyond the longest step, slacks that would come too close to their bounds stop there, each by itself.
void Barrier::move(double alpha) {
    if (alpha <= longest_) {
        for (int i = 0; i < num_rows(); ++i) slack_moved_[i] = slack[i] + alpha * ds_[i];
        return;
    }
    const double rest = std::min(least_rest, std::max(least_clipped, parameter_));
    for (int i = 0; i < num_rows(); ++i) {
        const double lower = limits_.lower[i], upper = limits_.upper[i], moved = slack[i] + alpha * ds_[i];
        const double least = has(lower) ? lower + rest * (slack[i] - lower) : lower;
        const double most = has(upper) ? upper - rest * (upper - slack[i]) : upper;
        slack_moved_[i] = std::min(std::max(moved, least), most);
    }
}

bool Barrier::evaluate_moved(const Point& moved, Trial& t) {
    const bool ok = limits_.values(moved, h_);
    LogBarrier barrier;
    Vec violations = {};
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack_moved_), defect = rows.of(h_) - s;
        violations += defect < 0.0 ? -defect : defect;
        barrier.add(sides.has_lower, s - sides.lower), barrier.add(sides.has_upper, sides.upper - s);
    });
    t.violation += dense::sum_of(violations), t.objective += barrier.value(parameter_);
    return ok && barrier.is_ok();
}

// Multipliers of bounds are kept near the central path.
void Barrier::accept(double alpha, double alpha_limits) {
    slack.swap(slack_moved_);
    for (std::size_t k = 0; k < dlambda_.size(); ++k) z_upper[limits_.equations[k].row] += alpha * dlambda_[k];
    for_rows(num_rows(), [&](const Rows& rows) {
        const Sides sides(limits_, rows);
        const Vec s = rows.of(slack);
        const auto move = [&](Indices has, Vec distance, const Numbers& dz, Numbers& z) {
            const Vec centre = parameter_ / distance, before = rows.of(z), least = centre / most_off_centre;
            const Vec moved = larger(before + alpha_limits * rows.of(dz), least), most = centre * most_off_centre;
            rows.store(has ? (most < moved ? most : moved) : before, z);
        };
        move(sides.has_lower, s - sides.lower, dz_lower_, z_lower);
        move(sides.has_upper, sides.upper - s, dz_upper_, z_upper);
    });
}

}  // namespace mbocp
