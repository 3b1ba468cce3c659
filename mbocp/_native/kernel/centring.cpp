#include "centring.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

namespace {

constexpr std::size_t memory = 4;    // residuals, of which the next one has to be below the largest ...
constexpr double progress = 0.9999;  // ... times this ...
constexpr double growth = 100.0;     // ... and below the smallest times this
constexpr int returns = 1;           // to free parameters, after which they stay fixed
constexpr double power = 3.0;        // of the part of the products that a step without barrier leaves
constexpr double of_error = 1e-4;    // of the defects of the barrier problem: far smaller products leave the centre
constexpr double least_step = 0.1;   // without barrier: beyond a shorter one products are no guide
constexpr double of_mean = 0.8;      // of all products: the least parameter that begins where they are fixed

double largest_of(const std::vector<double>& values) { return *std::max_element(values.begin(), values.end()); }
double smallest_of(const std::vector<double>& values) { return *std::min_element(values.begin(), values.end()); }

void remember(std::vector<double>& values, double value) {
    if (values.size() == memory) values.erase(values.begin());
    values.push_back(value);
}

}  // namespace

void Centring::update(double residual, double barrier, bool is_newtons) {
    if (is_free_ && is_progress(residual)) {
        remember(residuals_, residual), remember(barriers_, barrier);
    } else if (is_free_) {
        fix();
    } else if (is_newtons && num_fixed_ <= returns && !residuals_.empty() && residual < smallest_of(residuals_)) {
        is_free_ = true;
        residuals_.assign(1, residual), barriers_.assign(1, barrier);
    }
}

double Centring::fixed_barrier(double mean) const {
    return barriers_.empty() ? of_mean * mean : std::max(largest_of(barriers_), of_mean * mean);
}

double Centring::least_barrier(double error) const { return std::min(first_, of_error * error); }

double Centring::aimed_barrier(double mean, double foreseen) {
    const double share = mean > 0.0 ? std::max(0.0, foreseen / mean) : 0.0;
    return mean * std::min(1.0, std::pow(share, power));
}

bool Centring::may_correct(double longest) { return longest >= least_step; }

bool Centring::is_progress(double residual) const {
    if (!residuals_.empty() && residual > growth * smallest_of(residuals_)) return false;
    return residuals_.size() < memory || residual <= progress * largest_of(residuals_);
}

}  // namespace mbocp
