// The interior-point method's part of a Newton step, [Waechter2006].
//
// Every row of the limits has a slack s, h - s = 0, strictly between its bounds; in place of the bounds the cost gets
// the barrier -mu log(s - lower) - mu log(upper - s), and the multipliers z of the bounds are unknowns of their own.
// Slacks and multipliers are eliminated from the linear system: a row adds J' Sigma J to the Hessian of its state or
// control, Sigma = z_l / (s - lower) + z_u / (upper - s).
#pragma once

#include "limits.hpp"
#include "results.hpp"

namespace mbocp {

class Barrier {
public:
    explicit Barrier(const Problem& problem) : limits_(problem) {}

    void set_limits(const Bounds& bounds, Function path, Function guard);
    const Limits& limits() const { return limits_; }
    bool empty() const { return limits_.empty(); }
    int num_rows() const { return limits_.num_rows(); }

    Numbers slack, z_lower, z_upper;  // part of the iterate
    // Positive where an upper limit is active: rows of the stages, then guards.
    Numbers multipliers() const;

    // Slacks at the values of a point, moved inside by a part of their bounds and of the gap between them, and
    // multipliers that suit the barrier parameter.
    void start(const Point& at, double parameter, double inside);
    // Values, defects and derivatives of all rows.
    bool evaluate(const Point& at);
    const Numbers& defect() const { return defect_; }  // h - s
    double parameter() const { return parameter_; }
    // Another barrier parameter at the point of the last evaluation, and what of it depends on that.
    void set_parameter(double parameter);
    void finish(Evaluation& e) const;

    // In the linear system.
    void add_gradients(Residual& out) const { limits_.add_transposed(force_, out); }
    void add_to_value(int n, double* P) const { limits_.add_to_value(n, sigma_, P); }
    void add_to_controls(int n, double* Quu, int ld) const;
    void add_products(int n, const double* dx, const double* du, double* Hx, double* Hu) const {
        limits_.add_products(n, sigma_, dx, du, Hx, Hu);
    }
    // Slacks and multipliers along the direction, how far these allow to go, and the barrier's part of the slope.
    void find_step(const Increment& step, Direction& d);

    // Slacks moved along the direction; barrier and defects there; the move taken over, multipliers on their way.
    void move(double alpha);
    bool evaluate_moved(const Point& moved, Trial& t);
    void accept(double alpha);

private:
    Limits limits_;
    double parameter_ = 0;              // mu
    Numbers h_, defect_;                // values of the rows; h - s
    Numbers sigma_, force_;             // Sigma; what the row adds to the right-hand side's gradient, before J'
    Numbers ds_, dz_lower_, dz_upper_;  // of the last direction
    Numbers slack_moved_;
};

}  // namespace mbocp
