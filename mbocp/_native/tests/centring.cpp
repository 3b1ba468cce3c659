// Barrier parameters that steps choose: when they are free, and how large they are.
#include "../kernel/centring.hpp"

#include <algorithm>
#include <cmath>

#include "checks.hpp"

namespace mbocp::tests {
namespace {

constexpr int many = 200;

Centring after(const std::vector<double>& residuals) {
    Centring centring(1.0, Filter::start(0.0, false));
    for (const double residual : residuals) centring.update(residual, 1e-3 * residual, false);
    return centring;
}

TEST(aimed_barriers) {
    Random random(1);
    for (int i = 0; i < many; ++i) {
        const double mean = std::exp(random.uniform(-20.0, 20.0)), unit = std::exp(random.uniform(-5.0, 5.0));
        const double less = random.uniform(0.0, 1.0), more = random.uniform(less, 1.0);
        const double barrier = Centring::aimed_barrier(mean, less * mean);
        check(barrier >= 0.0 && barrier <= mean, "a part of the mean");
        check(std::abs(Centring::aimed_barrier(unit * mean, unit * less * mean) - unit * barrier) <=
                  1e-12 * unit * mean,
              "whatever the unit");
        check(barrier <= Centring::aimed_barrier(mean, more * mean) * (1.0 + 1e-12), "the less, the more a step gains");
        check(Centring::aimed_barrier(mean, (1.5 + 99.0 * less) * mean) == mean,
              "to the centre where it gains nothing");
    }
}

TEST(parameters_are_fixed_exactly_where_residuals_do_not_fall) {
    Random random(2);
    for (int i = 0; i < many; ++i) {
        std::vector<double> residuals(4);
        for (double& residual : residuals) residual = random.uniform(1.0, 50.0);
        std::sort(residuals.rbegin(), residuals.rend());
        Centring falls = after(residuals), rests = after(residuals);
        check(falls.is_free(), "free while residuals fall");
        falls.update(0.5 * residuals[0], 1e-3, false);
        check(falls.is_free(), "free below the largest of the last ones");
        rests.update(residuals[0], 1e-3, false);
        check(!rests.is_free(), "fixed where the largest one comes again");
    }
}

TEST(parameters_are_fixed_at_once_where_a_residual_leaps) {
    for (const double residual : {1e-12, 1.0, 1e12}) check(!after({residual, 101.0 * residual}).is_free(), "a leap");
}

TEST(a_fixed_parameter_is_none_of_the_small_ones) {
    check(after({8.0, 4.0}).fixed_barrier(1e-6) == 8e-3, "the largest of the last ones");
    check(after({8.0, 4.0}).fixed_barrier(1.0) == 0.8, "or near the mean");
    check(Centring(1.0, Filter()).fixed_barrier(2.0) == 1.6, "or that alone");
}

TEST(parameters_are_free_once_more_where_newtons_steps_are_better_than_all_before) {
    Centring centring = after({8.0, 4.0});
    centring.fix();
    centring.update(1.0, 1e-3, false);
    check(!centring.is_free(), "fixed where steps are not Newton's");
    centring.update(4.0, 1e-3, true);
    check(!centring.is_free(), "fixed where they are no better");
    centring.update(3.9, 1e-3, true);
    check(centring.is_free(), "free again");
    centring.fix();
    centring.update(1e-9, 1e-3, true);
    check(!centring.is_free(), "but once");
}

}  // namespace
}  // namespace mbocp::tests
