#include "filter.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

// Relative decrease of the violation, or of the cost against the violation, that counts as progress.
constexpr double margin = 1e-5;
constexpr double armijo = 1e-4;                                  // fraction of the predicted decrease of the cost
constexpr double slope_power = 2.3, violation_power = 1.1;       // switching condition
constexpr double round_off = 1e-13;                              // of the cost's own sum
constexpr double farthest = 1e3, farthest_within_limits = 10.0;  // violation, by the first iterate's or one

}  // namespace

Filter Filter::start(double violation, bool is_limited) {
    Filter filter;
    const double scale = std::max(1.0, violation);
    filter.most_violation_ = (is_limited ? farthest_within_limits : farthest) * scale;
    filter.least_violation_ = 1e-4 * scale;
    return filter;
}

Verdict Filter::accepts(const Trial& before, const Trial& trial, double slope, double length) const {
    if (!trial.finite || trial.violation > most_violation_ || forbids(trial)) return {};
    const double slack = round_off * std::abs(before.objective);
    if (must_descend(before.violation, slope, length))
        return {trial.objective <= before.objective + armijo * length * slope + slack, true};
    const bool are_feasible = before.is_feasible() && trial.is_feasible();
    return {trial.violation <= (1.0 - margin) * before.violation ||
                trial.objective <= before.objective - margin * before.violation + slack ||
                (are_feasible && trial.objective <= before.objective + 10.0 * slack),
            false};
}

bool Filter::accepts_after_relaxation(const Trial& reference, const Trial& trial) const {
    return trial.finite && trial.violation <= (1.0 - margin) * reference.violation && !forbids(trial);
}

Filter Filter::with_corner(const Trial& before) const {
    Filter filter = *this;
    filter.corners_.push_back({(1.0 - margin) * before.violation, before.objective - margin * before.violation});
    return filter;
}

Filter Filter::without_corners() const {
    Filter filter = *this;
    filter.corners_.clear();
    return filter;
}

bool Filter::forbids(const Trial& trial) const {
    return std::any_of(corners_.begin(), corners_.end(), [&](const Corner& corner) {
        return trial.violation >= corner.violation && trial.objective >= corner.objective;
    });
}

bool Filter::must_descend(double violation, double slope, double length) const {
    return violation <= least_violation_ && slope < 0.0 &&
           length * std::pow(-slope, slope_power) > std::pow(violation, violation_power);
}

}  // namespace mbocp
