// The interior-point method's part of a Newton step, [Waechter2006].
//
// Every row of the limits has a slack s, h - s = 0, strictly between its bounds; in place of the bounds the cost gets
// the barrier -mu log(s - lower) - mu log(upper - s), and the multipliers z of the bounds are unknowns of their own.
// Slacks and multipliers are eliminated from the linear system: a row adds J' Sigma J to the Hessian of its state or
// control, Sigma = z_l / (s - lower) + z_u / (upper - s).
//
// An equation h = b has a multiplier lambda, free in sign, and no slack that moves. Its row of the linear system is
// regularised, J dx - delta dlambda = -(h - b), [Friedlander2012], so that it is eliminated, too: it adds J'J / delta
// to the Hessian and J'(lambda + (h - b) / delta) to the gradient. Centred at the last lambda, this changes no
// solution, and rows that repeat others do no harm. A direction is found in passes, each with the multipliers of the
// one before, until delta has no part in it.
#pragma once

#include "limits.hpp"
#include "results.hpp"

namespace mbocp {

class Barrier {
public:
    explicit Barrier(const Problem& problem) : limits_(problem) {}

    void set_limits(const Bounds& bounds, Function path, Function path_values, Function guard);
    const Limits& limits() const { return limits_; }
    bool empty() const { return limits_.empty(); }
    int num_rows() const { return limits_.num_rows(); }

    // Part of the iterate. The slack of an equation is its value, and its multiplier, of any sign, is in z_upper.
    Numbers slack, z_lower, z_upper;
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
    // The same in the right-hand side alone: the matrix does not depend on the parameter. With `is_curved` the next
    // direction also makes up for the products of the last one's parts in distances and multipliers, [Mehrotra1992].
    void aim(double parameter, bool is_curved);
    void finish(Evaluation& e) const;

    // In the linear system.
    void add_gradients(Residual& out) const { limits_.add_transposed(force_, out); }
    void add_to_value(int n, double* P) const { limits_.add_to_value(n, sigma_, P); }
    void add_to_controls(int n, double* Quu, int ld) const;
    void add_products(int n, const double* dx, const double* du, double* Hx, double* Hu) const {
        limits_.add_products(n, sigma_, dx, du, Hx, Hu);
    }
    // What delta of a stage's equations goes by: the stage's response (x, y) = T (state before, u), and its Hessian in
    // the latter, both with leading dimension ld.
    void learn(int n, const double* T, const double* Hss, int ld, int nd);
    // Equations begin with their defects, or with alpha of these and those of the last `evaluate_moved`; before
    // `add_gradients`.
    void start_equations();
    void correct_equations(double alpha);
    // Of another right-hand side, to which inequalities give nothing: minus these, by the equations' order.
    void start_equations(const Numbers& rhs);
    // The largest by which a step misses the equations, by the largest of their terms, or what their multipliers would
    // still change, by their largest: whichever is less.
    double missed(const Increment& step);
    const Numbers& equation_step() const { return dlambda_; }
    // The equations' multipliers along the direction. Another pass may change them, and has what this one changed added
    // to its right-hand side; where passes change nothing but always the same, as of rows that repeat others, that is
    // taken back.
    enum class Passes { enough, more, repeat };
    struct Accuracy {  // of the multipliers' step, and of the multipliers themselves: a change by this part is none
        double of_step, of_all;
        static Accuracy of_newton() { return {1e-4, 1e-12}; }
        static Accuracy full() { return {1e-11, 0.0}; }
    };
    Passes resolve_equations(const Increment& step, const Accuracy& accuracy);
    void take_back(int passes);
    void add_pass(Residual& out) const { limits_.add_transposed(pass_, out); }
    bool has_equations() const { return !missed_.empty(); }
    bool has_equations(int n) const {
        return has_equations() && limits_.equations_of(n).first < limits_.equations_of(n).second;
    }
    // Slacks and multipliers along the direction, how far these allow to go, and the barrier's part of the slope.
    void find_step(const Increment& step, Direction& d);

    // The mean of multipliers times distances after these parts of the direction, with slacks that stop at bounds.
    double mean_product(double alpha, double alpha_limits) const;

    // Slacks moved along the direction, where that is longer than limits allow each to its own bound at most; barrier
    // and defects there; the move taken over, multipliers on their way.
    void move(double alpha);
    bool evaluate_moved(const Point& moved, Trial& t);
    void accept(double alpha, double alpha_limits);

private:
    void begin_equations();

    Limits limits_;
    double parameter_ = 0;                 // mu
    Numbers lambda_, h_, defect_;          // the rows' multipliers and values; h - s
    Numbers sigma_, force_;                // Sigma; what the row adds to the right-hand side's gradient, before J'
    Numbers ds_, dz_lower_, dz_upper_;     // of the last direction
    Numbers curved_lower_, curved_upper_;  // products that the next one makes up for
    double longest_ = 1.0;                 // part of the last direction that cuts no slack short
    Numbers slack_moved_;
    // Of the equations: 1 / delta, and what it goes by, 0 where that is not known; size of their terms; what the
    // right-hand side has for their defects; multipliers along the direction.
    Numbers weight_, response_, reach_, missed_, dlambda_;
    Numbers pass_;  // by row, what the last pass has added to these
};

}  // namespace mbocp
