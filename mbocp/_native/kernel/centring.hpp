// Barrier parameters that steps choose themselves while that goes well, [Mehrotra1992], [Nocedal2009].
//
// Free parameters. The step with no barrier at all, of the factors at hand, says what it would leave of the products of
// multipliers and distances. The cube of that part, of their mean, is the parameter mu of the step that is taken. Where
// the step without a barrier is not cut too short, what its parts in distances and in multipliers come to together is
// made up for, too, by another right-hand side of the same factors.
//
// Fixed parameters. Nothing makes such a sequence converge. At the first sign of trouble, a residual that does not fall
// or a step that is hardly one, mu is fixed at the largest of the last ones, or near the mean of all products if that
// is larger, and falls by a rule. When Newton's full steps have brought the residual below all that was reached with
// free parameters, these are tried once more.
#pragma once

#include <vector>

#include "filter.hpp"

namespace mbocp {

class Centring {
public:
    // With the barrier parameter and the filter of the guess. What that filter says of the violation holds for all free
    // parameters: bounds that rose with each new one would be none.
    Centring(double first, const Filter& bounds) : first_(first), bounds_(bounds) {}

    // What a residual, reached with a barrier parameter, says of those to come; `is_newtons`: with a full step without
    // a shift.
    void update(double residual, double barrier, bool is_newtons);
    void fix() { is_free_ = false, ++num_fixed_; }

    bool is_free() const { return is_free_; }
    const Filter& bounds() const { return bounds_; }
    // To begin with where it is fixed; `mean` of all products.
    double fixed_barrier(double mean) const;
    // The least free one where the conditions of the barrier problem have this defect.
    double least_barrier(double error) const;
    // Of a step; `foreseen` is the mean of all products after a step without barrier.
    static double aimed_barrier(double mean, double foreseen);
    // Whether to make up for the products of a step without barrier, of which limits allow that part.
    static bool may_correct(double longest);

private:
    bool is_progress(double residual) const;

    double first_;
    Filter bounds_;
    bool is_free_ = true;
    std::vector<double> residuals_, barriers_;  // the last ones that were reached with free parameters
    int num_fixed_ = 0;
};

}  // namespace mbocp
