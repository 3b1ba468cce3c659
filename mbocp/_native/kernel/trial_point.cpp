#include "trial_point.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {

TrialPoint::TrialPoint(const Problem& problem, Iterate& iterate, Barrier& barrier)
    : problem_(problem), iterate_(iterate), barrier_(barrier), moved_(problem), c_(iterate.m.size(), 0.0),
      g_(problem.ng, 0.0), costs_(static_cast<std::size_t>(problem.N), 0.0), groups_(problem.groups(&Kind::values)) {}

bool TrialPoint::move(const Increment& step, double alpha) {
    const Numbers &x = iterate_.x, &y = iterate_.y, &u = iterate_.u;
    for (std::size_t i = 0; i < y.size(); ++i) moved_.y[i] = y[i] + alpha * step.dy[i];
    for (std::size_t i = 0; i < u.size(); ++i) moved_.u[i] = u[i] + alpha * step.du[i];
    std::copy(x.begin(), x.begin() + problem_.nx, moved_.x.begin());
    barrier_.move(alpha);
    return problem_.retract_nodes(x, step.dx, alpha, moved_.x);
}

bool TrialPoint::evaluate_group(const Group& group, int thread) {
    StageFunction& f = problem_.kind().values->of(thread);
    const bool ok = problem_.call(f, group, moved_);
    const Pattern& rows = f.outputs[0];
    const double* values = f.values(0);
    for (int i = 0; i < group.count; ++i) {
        double* c = c_.data() + problem_.m_offset[group.stage[i]];
        for (int k = 0; k < rows.nnz(); ++k) c[rows.row[k]] = values[k * f.num_lanes + i];
        costs_[group.stage[i]] = f.outputs[1].nnz() ? f.values(1)[i] : 0.0;
    }
    return ok;
}

Trial TrialPoint::evaluate(const Increment& step, double alpha) {
    Trial t;
    bool ok = move(step, alpha);
    std::atomic<bool> all_ok{true};
    const auto prepare = [&](int thread) { problem_.prepare(problem_.kind().values->of(thread), false); };
    problem_.crew().share(section_, static_cast<int>(groups_.size()), true, prepare,
                          [&](int thread, int first, int last) {
                              for (int i = first; i < last; ++i)
                                  if (!evaluate_group(groups_[i], thread)) all_ok = false;
                          });
    ok = all_ok && ok;
    for (const Group& group : groups_)
        for (int i = 0; i < group.count; ++i) {
            const int n = group.stage[i];
            for (int row = problem_.m_offset[n]; row < problem_.m_offset[n + 1]; ++row)
                t.violation += std::abs(c_[row]);
            t.objective += costs_[n];
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
