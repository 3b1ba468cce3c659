#include "forward_sweep.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

ForwardSweep::ForwardSweep(const Problem& problem, Iterate& iterate, Step& step, const Elimination& gains)
    : problem_(problem), iterate_(iterate), step_(step), gains_(gains), c_(problem.kind().nw(), 0.0),
      direction_(problem.kind().nw(), 0.0), simplified_(problem.kind().nw(), 0.0), dx_(problem.ndx, 0.0),
      x_before_(problem.nx, 0.0), y_before_(problem.kind().nw(), 0.0), left_over_(problem.ndx, 0.0),
      planned_(problem.nx, 0.0) {}

Sweep ForwardSweep::run(double tolerance, int max_iterations, bool warm, bool feedback, bool compensated) {
    Sweep sweep;
    dense::zero(left_over_.data(), problem_.ndx);
    double largest = 0;
    for (int n = 0; n < problem_.N; ++n) {
        sweep.residual = 0;
        bool ok = !feedback || feed_back(n);
        if (ok)
            ok = solve(n, tolerance, max_iterations, warm, sweep) ||
                 (warm && solve(n, tolerance, max_iterations, false, sweep));
        if (!ok) {
            sweep.failed_stage = n;
            return sweep;
        }
        if (compensated) std::copy(c_.begin(), c_.begin() + problem_.ndx, left_over_.begin());
        largest = std::max(largest, sweep.residual);
    }
    sweep.residual = largest, sweep.ok = true;
    return sweep;
}

// Controls of stage n for the state that the sweep has come to; the state planned for its end is remembered.
bool ForwardSweep::feed_back(int n) {
    const double* now = iterate_.x.data() + problem_.x_offset(n);
    if (n > 0) {
        if (!problem_.difference(planned_.data(), now, dx_.data())) return false;
        gains_.feed_back(n, dx_.data(), iterate_.u.data() + problem_.u_offset[n]);
    }
    std::copy(now + problem_.nx, now + 2 * problem_.nx, planned_.begin());
    return true;
}

// c of the last call with what is left over, and its largest entry; infinite where it is not finite.
double ForwardSweep::residual(const StageFunction& f) {
    double norm = 0;
    const int nc = problem_.kind().nc();
    const Pattern& rows = f.outputs[0];
    dense::zero(c_.data(), nc);
    for (int i = 0; i < rows.nnz(); ++i) c_[rows.row[i]] = f.res[0][i];
    for (int i = 0; i < problem_.ndx; ++i) c_[i] += left_over_[i];
    for (int i = 0; i < nc; ++i) norm = std::max(norm, std::isfinite(c_[i]) ? std::abs(c_[i]) : INFINITY);
    return norm;
}

// Whether the correction that the old derivatives ask for at the new point is smaller.
bool ForwardSweep::is_contracting(int n, double factor) {
    std::copy(c_.begin(), c_.begin() + problem_.kind().nc(), simplified_.begin());
    step_.solve(n, simplified_.data());
    double now = 0, then = 0;
    for (int i = 0; i < problem_.ndx; ++i)
        now += simplified_[i] * simplified_[i], then += direction_[i] * direction_[i];
    return std::sqrt(now) <= (1.0 - 0.25 * factor) * std::sqrt(then);
}

// One implicit step by Newton's method, with the step halved where it gets worse: where the residual grows and the
// correction that the old derivatives ask for at the new point is no smaller, either (Deuflhard's natural monotonicity
// test). The residual alone would not do: its rows are momenta and constraints, and a good step along the tangent of a
// constraint turns the one into the other.
bool ForwardSweep::solve(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep) {
    const Kind& k = problem_.kind();
    StageFunction& f = *k.jacobian;
    double *x1 = iterate_.x.data() + problem_.x_offset(n + 1), *y1 = iterate_.y.data() + problem_.y_offset[n];
    if (!warm) {
        std::copy(x1 - problem_.nx, x1, x1);
        if (n > 0) std::copy(y1 - k.ny, y1, y1);
    }
    bool has_direction = false;
    double before = INFINITY, factor = 1.0;
    for (int iteration = 0; iteration <= max_iterations; ++iteration, ++sweep.iterations) {
        const bool ok = problem_.call(f, n, iterate_);
        const double norm = residual(f);
        const bool finite = ok && std::isfinite(norm);
        sweep.residual = std::max(sweep.residual, norm);
        if (finite && norm <= tolerance) return sweep.residual = norm, true;
        // A full step at the level of round-off cannot improve further.
        if (finite && iteration > 3 && norm < 1e4 * tolerance && norm >= before && factor == 1.0)
            return sweep.residual = norm, true;
        bool better = norm <= before * (1.0 + 1e-3 * factor) + 1e3 * tolerance;
        if (finite && !better && has_direction) better = is_contracting(n, factor);
        if (finite && better) {
            before = norm, factor = 1.0;
            std::copy(x1, x1 + problem_.nx, x_before_.begin());
            std::copy(y1, y1 + k.ny, y_before_.begin());
            if (step_.factor_first(n, f) == 0.0) return false;
            std::copy(c_.begin(), c_.begin() + k.nc(), direction_.begin());
            step_.solve(n, direction_.data());
            has_direction = true;
        } else if ((factor *= 0.5) < 1e-6 || !has_direction) {
            return false;
        }
        for (int i = 0; i < problem_.ndx; ++i) dx_[i] = -direction_[i];
        if (!problem_.retract(x_before_.data(), dx_.data(), factor, x1)) return false;
        for (int i = 0; i < k.ny; ++i) y1[i] = y_before_[i] - factor * direction_[problem_.ndx + i];
    }
    return false;
}

}  // namespace mbocp
