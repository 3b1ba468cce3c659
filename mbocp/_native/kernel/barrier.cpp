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

// -mu log of the distances, many factors to a logarithm.
struct LogBarrier {
    double product = 1.0, sum = 0.0;
    bool ok = true;

    void add(double distance) {
        ok = ok && distance > 0.0;
        product *= distance;
        if (product < 1e-200 || product > 1e200) sum += std::log(product), product = 1.0;
    }
    double value(double mu) const { return -mu * (sum + std::log(product)); }
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
    for (int i = 0; i < num_rows(); ++i) {
        const double lower = limits_.lower[i], upper = limits_.upper[i];
        double sigma = 0;
        if (has(lower)) sigma += z_lower[i] / (slack[i] - lower);
        if (has(upper)) sigma += z_upper[i] / (upper - slack[i]);
        sigma_[i] = sigma;
    }
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
    for (int i = 0; i < num_rows(); ++i) {
        const double lower = limits_.lower[i], upper = limits_.upper[i];
        curved_lower_[i] = is_curved ? ds_[i] * dz_lower_[i] : 0.0;
        curved_upper_[i] = is_curved ? -ds_[i] * dz_upper_[i] : 0.0;
        double force = 0;
        if (has(lower)) force -= (parameter - curved_lower_[i]) / (slack[i] - lower);
        if (has(upper)) force += (parameter - curved_upper_[i]) / (upper - slack[i]);
        force_[i] = force + sigma_[i] * defect_[i];
    }
}

void Barrier::finish(Evaluation& e) const {
    LogBarrier barrier;
    double squared = 0;
    for (int i = 0; i < num_rows(); ++i) {
        const auto add = [&](double distance, double z) {
            const double product = distance * z;
            barrier.add(distance);
            squared += product * product;
            e.barrier_error = std::max(e.barrier_error, std::abs(product - parameter_));
        };
        if (has(limits_.lower[i])) add(slack[i] - limits_.lower[i], z_lower[i]);
        if (has(limits_.upper[i])) add(limits_.upper[i] - slack[i], z_upper[i]);
    }
    e.objective = e.cost + barrier.value(parameter_);
    e.complementarity = std::sqrt(squared);
    e.dual = std::hypot(e.dual, e.complementarity);
    e.residual = std::hypot(e.primal, e.dual);
    e.finite = e.finite && barrier.ok && std::isfinite(e.residual) && std::isfinite(e.objective);
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
    double approach = 0, decline = 0;  // largest relative loss of a distance, and of a multiplier
    for (int i = 0; i < num_rows(); ++i) {
        const double ds = ds_[i] += defect_[i];
        if (has(limits_.lower[i])) {
            const double inverse = 1.0 / (slack[i] - limits_.lower[i]);
            dz_lower_[i] = (mu - curved_lower_[i] - z_lower[i] * ds) * inverse - z_lower[i];
            approach = std::max(approach, -ds * inverse), decline = std::max(decline, -dz_lower_[i] / z_lower[i]);
            d.slope -= mu * inverse * ds;
        }
        if (has(limits_.upper[i])) {
            const double inverse = 1.0 / (limits_.upper[i] - slack[i]);
            dz_upper_[i] = (mu - curved_upper_[i] + z_upper[i] * ds) * inverse - z_upper[i];
            approach = std::max(approach, ds * inverse), decline = std::max(decline, -dz_upper_[i] / z_upper[i]);
            d.slope += mu * inverse * ds;
        }
    }
    for (const Equation& e : limits_.equations) ds_[e.row] = 0.0;
    d.longest = longest_ = approach > tau ? tau / approach : 1.0;
    d.longest_dual = decline > tau ? tau / decline : 1.0;
}

double Barrier::mean_product(double alpha, double alpha_limits) const {
    double sum = 0;
    int count = 0;
    for (int i = 0; i < num_rows(); ++i) {
        const auto add = [&](double distance, double approach, double z, double dz) {
            sum += std::max(distance + alpha * approach, 0.0) * (z + alpha_limits * dz), ++count;
        };
        if (has(limits_.lower[i])) add(slack[i] - limits_.lower[i], ds_[i], z_lower[i], dz_lower_[i]);
        if (has(limits_.upper[i])) add(limits_.upper[i] - slack[i], -ds_[i], z_upper[i], dz_upper_[i]);
    }
    return count ? sum / count : 0.0;
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
    for (int i = 0; i < num_rows(); ++i) {
        t.violation += std::abs(h_[i] - slack_moved_[i]);
        if (has(limits_.lower[i])) barrier.add(slack_moved_[i] - limits_.lower[i]);
        if (has(limits_.upper[i])) barrier.add(limits_.upper[i] - slack_moved_[i]);
    }
    t.objective += barrier.value(parameter_);
    return ok && barrier.ok;
}

// Multipliers of bounds are kept near the central path.
void Barrier::accept(double alpha, double alpha_limits) {
    slack.swap(slack_moved_);
    for (std::size_t k = 0; k < dlambda_.size(); ++k) z_upper[limits_.equations[k].row] += alpha * dlambda_[k];
    for (int i = 0; i < num_rows(); ++i) {
        const auto moved = [&](double z, double dz, double distance) {
            const double centre = parameter_ / distance;
            return std::min(std::max(z + alpha_limits * dz, centre / most_off_centre), centre * most_off_centre);
        };
        if (has(limits_.lower[i])) z_lower[i] = moved(z_lower[i], dz_lower_[i], slack[i] - limits_.lower[i]);
        if (has(limits_.upper[i])) z_upper[i] = moved(z_upper[i], dz_upper_[i], limits_.upper[i] - slack[i]);
    }
}

}  // namespace mbocp
