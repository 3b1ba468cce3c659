#include "structured_elimination.hpp"

namespace mbocp {
using dense::padded;

StructuredElimination::StructuredElimination(const Problem& problem, Data& data, Step& step, Barrier& barrier,
                                             EndMultiplier& eta)
    : problem_(problem), data_(data), step_(step), controls_(problem, data, barrier, eta) {
    const Kind& k = problem.kind();
    const std::size_t vectors = padded(k.nw()) + padded(k.ns());
    scratch_.allocate(12 * vectors + 256), work_.allocate(work_size(k) + k.structure->work_size() + 256);
}

// Beside the structure's own.
std::size_t StructuredElimination::work_size(const Kind& k) const {
    const Structure& t = *k.structure;
    const std::size_t ndx = problem_.ndx, px = padded(problem_.nd), pm = padded(problem_.nd + k.nu), pd = padded(t.d);
    const std::size_t pu = padded(k.nu), pg = padded(problem_.ng);
    const std::size_t hessian = t.nq * (pm + pd) + pd * (pm + pd) + (ndx + pu + 2 * px) * px + px * pm + t.ny * pd;
    return std::max({hessian, px * px + (px + pm) * (pg + pm), 2 * ndx * px + ndx + px});
}

bool StructuredElimination::start(const Residual& rhs, Factorisation& result) {
    const bool is_reduced = known_ != Known::nothing;
    for (int n = 0; n < problem_.N && known_ != Known::residuals; ++n) {
        if (!is_reduced) {
            if (!reduce(n, result)) return result.bad_stage = n, false;
            reduce_hessian(n);
        }
        reduce_residual(n, rhs);
    }
    if (!is_reduced) smallest_pivot_ = result.smallest_pivot;
    result.smallest_pivot = smallest_pivot_;
    known_ = Known::residuals;
    reduce_end();
    return true;
}

void StructuredElimination::prepare(const Residual& rhs) {
    for (int n = 0; n < problem_.N; ++n) reduce_residual(n, rhs);
    forget_residual();  // that of the iterate
}

// Factorises the step to node n + 1 and finds the reachable states there.
bool StructuredElimination::reduce(int n, Factorisation& result) {
    Stage& s = data_[n];
    const Structure& t = *s.kind->structure;
    const double pivot = step_.factor(n);
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    const StepFactor& before = n > 0 ? data_[n - 1].step : s.step;
    for (int j = 0; j < t.d; ++j) s.chosen[j] = s.step.free[j], s.chosen[t.d + j] = t.nq + before.free[j];
    for (int j = 0; j < t.nr; ++j) s.chosen[2 * t.d + j] = 2 * t.nq + j;
    t.reach(s.step, step_before(n), work_.data());
    return true;
}

// xi = T (xi before, u), and half the stage's Hessian in these, the value function and the shift left out.
void StructuredElimination::reduce_hessian(int n) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const StepFactor *before = step_before(n), &now = s.step;
    const int nd = problem_.nd, d = t.d, nq = t.nq, nu = k.nu;
    const int px = padded(nd), pm = padded(nd + nu), pd = padded(d), pu = padded(nu);
    Space space(work_.data());
    double *R = space.take(nq, pm), *beta = space.take(pd, pm), *S = space.zeros(k.ny, pd), *A = space.take(nq, pd);
    double *AK = space.zeros(pd, pd), *LB = space.zeros(problem_.ndx, px), *LuB = space.zeros(pu, px);
    double *M = space.zeros(px, px), *E = space.zeros(px, pm), *product = space.zeros(px, px), *work = space.take(0);
    t.respond(s.J, now, before, R, beta, s.T, pm, work);

    // E: what xi meets, in (xi before, u); first y
    k.of_y_in_q.times_matrix(s.H, now.N, pd, pd, S, pd);
    t.particular_matrix(s.J, now, S, A, work);
    dense::gemm_tn(d, d, nq, A, pd, now.KN, pd, AK, pd);
    dense::gemm_tn(d, pm, nq, A, pd, R, pm, E, pm);
    dense::gemm_nn(d, pm, d, AK, pd, beta, pm, E, pm, -1.0);
    for (int i = 0; i < d * pm; ++i) E[i] /= -now.dt;
    t.times_basis(k.of_u_in_x, s.H, now, LuB);
    for (int i = 0; i < nd; ++i)
        for (int j = 0; j < nu; ++j) E[i * pm + nd + j] += LuB[j * px + i];
    t.times_basis(k.of_x, s.H, now, LB);
    t.project_matrix(now, LB, M, px);

    double* Q = s.Q;
    dense::zero(Q, pm * pm);
    k.of_u.add_to(s.H, Q + nd * pm + nd, pm);
    if (before && !k.of_before_in_x.empty()) {
        dense::zero(LB, problem_.ndx * px);
        t.times_basis(k.of_before_in_x, s.H, now, LB);
        t.project_matrix(*before, LB, product, px);
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < nd; ++j) E[i * pm + j] += product[j * px + i];
    }
    if (before && !k.of_before.empty()) {
        dense::zero(LB, problem_.ndx * px);
        t.times_basis(k.of_before, s.H, *before, LB);
        t.project_matrix(*before, LB, Q, pm);
    }
    if (before && !k.of_u_in_before.empty()) {
        dense::zero(LuB, pu * px);
        t.times_basis(k.of_u_in_before, s.H, *before, LuB);
        for (int j = 0; j < nu; ++j) dense::axpy(nd, 1.0, LuB + j * px, Q + (nd + j) * pm);
    }
    dense::gemm_nn(nd, pm, nd, M, px, s.T, pm, E, pm);
    dense::gemm_tn(nd + nu, pm, nd, s.T, pm, E, pm, Q, pm);
}

// t0, which the step makes of its residual, b, and the gradient there.
void StructuredElimination::reduce_residual(int n, const Residual& rhs) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const int nd = problem_.nd, nu = k.nu, nw = k.nw(), ns = k.ns(), nx = problem_.ndx, px = padded(nd);
    Space space(scratch_.data());
    double *z = space.zeros(nw + ns), *h = space.take(nw + ns), *none = space.zeros(padded(t.d)),
           *mm = space.take(t.nq);
    double *ds = z + nw, *hs = h + nw, *xi = space.zeros(px);
    if (n > 0) dense::copy(data_[n - 1].b, ds, nx);
    dense::zero(s.t0, nw);
    t.Js.times(s.J, ds, s.t0, -1.0);
    for (int i = 0; i < nw; ++i) s.t0[i] -= rhs.c[problem_.m_offset[n] + i];
    step_.solve(n, s.t0);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    dense::copy(s.t0, s.b, nx);
    t.expand(s.step, xi, s.b, -1.0);

    dense::copy(rhs.w.data() + problem_.m_offset[n], h, nw);
    dense::copy(rhs.s.data() + problem_.s_offset(n), hs, ns);
    dense::copy(s.t0, z, nw);
    k.hessian.times(s.H, z, h);
    t.momentum_multipliers(s.J, s.step, none, h + nx, mm, work_.data());  // of y's gradient
    t.respond_transposed(s.J, s.step, mm, hs);
    double* g = s.g + px;
    dense::zero(s.g, px + padded(nd + nu));
    t.project(s.step, h, s.g);
    if (n > 0) t.project(data_[n - 1].step, hs, g);
    dense::copy(hs + nx, g + nd, nu);
}

// Value function of the last node, and the end condition's columns.
void StructuredElimination::reduce_end() {
    Stage& last = data_.last();
    const Structure& t = *last.kind->structure;
    const int nx = problem_.ndx, nd = problem_.nd, px = padded(nd), pg = padded(problem_.ng);
    Space space(work_.data());
    double *B = space.zeros(nx, px), *HB = space.zeros(nx, px), *column = space.take(nx), *sum = space.take(px);
    t.basis(last.step, B);
    for (int i = 0; i < nx; ++i)
        for (int j = 0; j < nx; ++j) {
            const double value = data_.end.H[i * padded(nx) + j];
            if (value != 0.0) dense::axpy(px, value, B + j * px, HB + i * px);
        }
    dense::zero(last.P, px * px);
    t.project_matrix(last.step, HB, last.P, px);
    for (int i = 0; i < nd; ++i)
        for (int j = 0; j < i; ++j)
            last.P[i * px + j] = last.P[j * px + i] = 0.5 * (last.P[i * px + j] + last.P[j * px + i]);
    for (int g = 0; g < problem_.ng; ++g) {
        for (int i = 0; i < nx; ++i) column[i] = data_.end.S[i * pg + g];
        dense::zero(sum, px);
        t.project(last.step, column, sum);
        for (int i = 0; i < nd; ++i) last.S[i * pg + g] = sum[i];
    }
}

void StructuredElimination::start_backward(const Residual& rhs, const Weights& weights, Numbers& r) {
    r = rhs.g;
    Stage& last = data_.last();
    const int nx = problem_.ndx, pg = padded(problem_.ng);
    dense::gemv_t(nx, problem_.ng, data_.end.S.data(), pg, last.b, r.data());  // g + S'b, and that is what is augmented
    double* slope = scratch_.data();
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), slope);
    dense::gemv(nx, nx, data_.end.H.data(), padded(nx), last.b, slope);
    dense::gemv(nx, problem_.ng, data_.end.S.data(), pg, r.data(), slope, weights.augment);
    dense::zero(last.p, padded(problem_.nd));
    last.kind->structure->project(last.step, slope, last.p);
}

bool StructuredElimination::condense(int n, const Weights& weights, Factorisation& result) {
    Stage& s = data_[n];
    const int nd = problem_.nd, nu = s.kind->nu, px = padded(nd), pm = padded(nd + nu), pg = padded(problem_.ng);
    const int ld = pg + pm;
    Space space(work_.data());
    double *P = space.zeros(px, px), *M = space.zeros(px, ld), *Q = space.zeros(pm, ld);
    if (weights.shift != 0.0) s.kind->structure->gram(s.step, P, px);
    for (int i = 0; i < px * px; ++i) P[i] = 0.5 * (weights.shift * P[i] + s.P[i]);
    for (int i = 0; i < nd; ++i) dense::copy(s.S + i * pg, M + i * ld, pg);
    dense::gemm_nn(nd, pm, nd, P, px, s.T, pm, M + pg, ld);
    for (int i = 0; i < nd + nu; ++i) dense::copy(s.Q + i * pm, Q + i * ld + pg, pm);
    dense::gemm_tn(nd + nu, ld, nd, s.T, pm, M, ld, Q, ld);
    dense::symmetrise(nd + nu, Q + pg, ld, nullptr, 0);
    return controls_.eliminate(n, {Q, Q + nd * ld, ld}, result);
}

void StructuredElimination::backward(int n, const Residual&, const Weights& weights, Numbers& r) {
    Stage& s = data_[n];
    const int nd = problem_.nd, nu = s.kind->nu, px = padded(nd), pm = padded(nd + nu), pg = padded(problem_.ng);
    Space space(scratch_.data());
    double *q = space.take(pm), *xi = space.zeros(px), *gain = space.take(px), *shifted = space.zeros(px);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    if (weights.shift != 0.0) s.kind->structure->project(s.step, s.t0, shifted);
    for (int i = 0; i < nd; ++i) gain[i] = s.p[i] + s.g[i] + weights.shift * shifted[i];
    dense::gemv(nd, nd, s.P, px, xi, gain);
    dense::copy(s.g + px, q, pm);
    dense::gemv_t(nd, nd + nu, s.T, pm, gain, q);
    for (int i = 0; i < nu; ++i) s.k[i] = -q[nd + i];
    controls_.solve(s, s.k);
    if (problem_.ng) {
        dense::gemv_t(nd, problem_.ng, s.S, pg, xi, r.data());
        dense::gemv_t(nu, problem_.ng, s.Keta, pg, q + nd, r.data());
    }
    if (n > 0) {
        double* p = data_[n - 1].p;
        dense::copy(q, p, nd);
        dense::gemv_t(nu, nd, s.K, px, q + nd, p);
    }
}

void StructuredElimination::forward(const Residual& rhs, const Weights& weights, Increment& out, KktCheck* check) {
    for (int n = 0; n < problem_.N; ++n) forward_stage(n, rhs, weights, out);
    other_multipliers(rhs, out);
    if (!check) return;
    for (int n = 0; n < problem_.N; ++n) check->add_stage(n, rhs, out, weights.shift, data_[n].Hz);
    check->add_end(rhs, out);
}

void StructuredElimination::forward_motion(Increment& out) {
    for (int n = 0; n < problem_.N; ++n) {
        Space space(scratch_.data());
        double *dw = space.take(problem_.ndx), *ds = space.take(problem_.kind().ns());
        find_motion(n, dw, ds, space, out);
    }
}

// Into dw and ds, and from there into the direction; returns xi.
const double* StructuredElimination::find_motion(int n, double* dw, double* ds, Space& space, Increment& out) const {
    const Stage& s = data_[n];
    const int nd = problem_.nd, nx = problem_.ndx, nu = s.kind->nu;
    const int px = padded(nd), pm = padded(nd + nu), pg = padded(problem_.ng);
    double *before = space.zeros(pm), *xi = space.zeros(px);
    const double* dx = out.dx.data() + problem_.dx_offset(n);
    double* du = out.du.data() + problem_.u_offset[n];
    if (n > 0)
        for (int i = 0; i < nd; ++i) before[i] = dx[data_[n - 1].chosen[i]];
    dense::copy(s.k, du, nu);
    dense::gemv(nu, nd, s.K, px, before, du);
    dense::gemv(nu, problem_.ng, s.Keta, pg, out.deta.data(), du);
    dense::copy(du, before + nd, nu);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    dense::gemv(nd, nd + nu, s.T, pm, before, xi);
    dense::copy(dx, ds, nx);
    dense::copy(du, ds + nx, nu);
    dense::copy(s.b, dw, nx);
    s.kind->structure->expand(s.step, xi, dw);
    dense::copy(dw, out.dx.data() + problem_.dx_offset(n + 1), nx);
    return xi;
}

// The motion, algebraic unknowns, and of the multipliers those of the momentum rows.
void StructuredElimination::forward_stage(int n, const Residual& rhs, const Weights& weights, Increment& out) {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const int nx = problem_.ndx, nw = k.nw(), ns = k.ns();
    Space space(scratch_.data());
    double *z = space.take(nw + ns), *dw = z, *ds = z + nw;
    const double* xi = find_motion(n, dw, ds, space, out);
    t.balance(s.J, s.step, dw, ds, rhs.c.data() + problem_.m_offset[n] + t.nq, dw + nx, work_.data());
    dense::copy(dw + nx, out.dy.data() + problem_.y_offset[n], k.ny);
    dense::zero(s.Hz, nw + ns);
    k.hessian.times(s.H, z, s.Hz);
    dense::axpy(nx, weights.shift, dw, s.Hz);
    momentum_multipliers(n, rhs, xi, out, space);
}

// Along the null space the costate's share is (dt, C')(P xi + p + S eta).
void StructuredElimination::momentum_multipliers(int n, const Residual& rhs, const double* xi, Increment& out,
                                                 Space& space) {
    const Stage& s = data_[n];
    const Structure& t = *s.kind->structure;
    const int nd = problem_.nd, nx = problem_.ndx, px = padded(nd), pd = padded(t.d);
    double *pi = space.take(px), *along = space.zeros(pd), *sum = space.take(s.kind->nw());
    const double *w = rhs.w.data() + problem_.m_offset[n], dt = s.step.dt;
    dense::copy(s.p, pi, nd);
    dense::gemv(nd, nd, s.P, px, xi, pi);
    dense::gemv(nd, problem_.ng, s.S, padded(problem_.ng), out.deta.data(), pi);
    for (int i = 0; i < t.nq; ++i) sum[i] = -dt * (w[i] + s.Hz[i]) - w[t.nq + i] - s.Hz[t.nq + i];
    for (int j = 0; j < t.d; ++j) along[j] = -dt * pi[j];
    dense::gemv_t(t.nq, pd, s.step.N, pd, sum, along);
    for (int j = 0; j < t.d; ++j) dense::axpy(t.d, -pi[t.d + j], s.step.N + (s.chosen[t.d + j] - t.nq) * pd, along);
    for (int i = 0; i < s.kind->ny; ++i) sum[i] = -w[nx + i] - s.Hz[nx + i];
    t.momentum_multipliers(s.J, s.step, along, sum, out.dm.data() + problem_.m_offset[n] + t.nq, work_.data());
}

// The other multipliers, which need the whole costate of the node.
void StructuredElimination::other_multipliers(const Residual& rhs, Increment& out) {
    const int nx = problem_.ndx, pg = padded(problem_.ng);
    Space space(scratch_.data());
    double *costate = space.take(problem_.kind().ns()), *b = space.take(problem_.kind().nw()), *mm = space.take(nx);
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), costate);
    dense::gemv(nx, nx, data_.end.H.data(), padded(nx), out.dx.data() + problem_.dx_offset(problem_.N), costate);
    dense::gemv(nx, problem_.ng, data_.end.S.data(), pg, out.deta.data(), costate);
    for (int n = problem_.N - 1; n >= 0; --n) {
        const Stage& s = data_[n];
        const Kind& k = *s.kind;
        const Structure& t = *k.structure;
        double* dm = out.dm.data() + problem_.m_offset[n];
        const double *w = rhs.w.data() + problem_.m_offset[n], *of_s = rhs.s.data() + problem_.s_offset(n);
        for (int i = 0; i < k.nw(); ++i) b[i] = -w[i] - s.Hz[i] - (i < nx ? costate[i] : 0.0);
        dense::copy(dm + t.nq, mm, t.nq);
        t.other_multipliers(s.J, s.step, b, mm, work_.data());
        dense::copy(b, dm, k.nw());
        for (int i = 0; i < k.ns(); ++i) costate[i] = of_s[i] + s.Hz[k.nw() + i];
        t.Js.transposed_times(s.J, dm, costate);
    }
}

void StructuredElimination::feed_back(int n, const double* dx, double* du) const {
    const Stage& s = data_[n];
    for (int j = 0; n > 0 && j < problem_.nd; ++j)
        for (int i = 0; i < s.kind->nu; ++i) du[i] += s.K[i * padded(problem_.nd) + j] * dx[data_[n - 1].chosen[j]];
}

void StructuredElimination::feed_back_transposed(int n, const double* du, double* dx) const {
    const Stage& s = data_[n];
    for (int j = 0; n > 0 && j < problem_.nd; ++j)
        for (int i = 0; i < s.kind->nu; ++i) dx[data_[n - 1].chosen[j]] += s.K[i * padded(problem_.nd) + j] * du[i];
}

}  // namespace mbocp
