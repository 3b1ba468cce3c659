#include "trial_point.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

TrialPoint::TrialPoint(const Problem& problem, Iterate& iterate, Barrier& barrier)
    : problem_(problem), iterate_(iterate), barrier_(barrier), moved_(problem), c_(iterate.m.size(), 0.0),
      g_(problem.ng, 0.0) {}

bool TrialPoint::move(const Increment& step, double alpha) {
    bool ok = true;
    const Numbers &x = iterate_.x, &y = iterate_.y, &u = iterate_.u;
    for (std::size_t i = 0; i < y.size(); ++i) moved_.y[i] = y[i] + alpha * step.dy[i];
    for (std::size_t i = 0; i < u.size(); ++i) moved_.u[i] = u[i] + alpha * step.du[i];
    std::copy(x.begin(), x.begin() + problem_.nx, moved_.x.begin());
    for (int n = 1; n <= problem_.N; ++n) {
        const std::size_t at = problem_.x_offset(n);
        const double* dx = step.dx.data() + problem_.dx_offset(n);
        ok = problem_.retract(x.data() + at, dx, alpha, moved_.x.data() + at) && ok;
    }
    barrier_.move(alpha);
    return ok;
}

Trial TrialPoint::evaluate(const Increment& step, double alpha) {
    Trial t;
    bool ok = move(step, alpha);
    for (int n = 0; n < problem_.N; ++n) {
        const Kind& k = problem_.kind(n);
        StageFunction& f = *k.values;
        ok = problem_.call(f, n, moved_) && ok;
        double* c = c_.data() + problem_.m_offset[n];
        for (int i = 0; i < f.outputs[0].nnz(); ++i) c[f.outputs[0].row[i]] = f.res[0][i];
        for (int i = 0; i < k.nc(); ++i) t.violation += std::abs(c[i]);
        t.objective += f.outputs[1].nnz() ? f.res[1][0] : 0.0;
    }
    StageFunction& f = *problem_.terminal.values;
    f.arg[0] = moved_.x.data() + problem_.x_offset(problem_.N);
    f.arg[1] = problem_.rho_terminal.data();
    ok = f.call() && ok;
    t.objective += f.outputs[0].nnz() ? f.res[0][0] : 0.0;
    for (int i = 0; i < f.outputs[1].nnz(); ++i) g_[f.outputs[1].row[i]] = f.res[1][i];
    for (int i = 0; i < problem_.ng; ++i) t.violation += std::abs(g_[i]);
    if (!barrier_.empty()) ok = barrier_.evaluate_moved(moved_, t) && ok;
    t.finite = ok && std::isfinite(t.objective) && std::isfinite(t.violation);
    return t;
}

void TrialPoint::accept(const Increment& step, double alpha, double alpha_limits) {
    iterate_.x.swap(moved_.x), iterate_.y.swap(moved_.y), iterate_.u.swap(moved_.u);
    for (std::size_t i = 0; i < iterate_.m.size(); ++i) iterate_.m[i] += alpha * step.dm[i];
    for (std::size_t i = 0; i < iterate_.eta.size(); ++i) iterate_.eta[i] += alpha * step.deta[i];
    barrier_.accept(alpha, alpha_limits);
}

}  // namespace mbocp
