// The Newton step of stages with a structure: value functions over the reachable states alone.
//
// Whatever the controls, the linearised constraints and kinematics of the steps up to node n leave
//
//   dq_n = N_n alpha,   dv_n = N_{n-1} gamma + (N_n - N_{n-1} C_n) alpha / dt,   C_n = N_n[E_{n-1}]
//
// and a part b_n that follows from the residuals of the two steps before. As N[E] is the identity, the coordinates
// xi = (alpha, gamma) are entries of dx_n themselves: dq_n[E_n] and dv_n[E_{n-1}]. With dx = B xi + b a stage becomes
// one over xi_{n-1}, xi_n and the controls, of 2 d entries, d the degrees of freedom, instead of all of the state's.
// That is done for each stage by itself; the Riccati recursion only sees what comes of it.
//
// y_n follows from the momentum rows. It is never formed for unit vectors: the Hessian knows it through (y, q) alone,
// and S'y, S = L_yq N, is A'(KN beta - R) / dt with Gd A = S.
//
// The multipliers need the whole costate, of which the value function knows B' times it. That is enough for the
// momentum rows; the others follow from them backwards, stage by stage, without a recursion that could grow.
#include "controls.hpp"

namespace mbocp {
using dense::padded;

namespace {

// Workspace, taken from the front, each part from the boundary of a cache line on.
class Space {
public:
    explicit Space(double* at) : at_(at) {}
    double* take(int rows, int columns = 1) { return at_ += last_, last_ = (rows * columns + 7) / 8 * 8, at_; }
    double* zeros(int rows, int columns = 1) {
        take(rows, columns);
        dense::zero(at_, last_);
        return at_;
    }

private:
    double* at_;
    int last_ = 0;
};

}  // namespace

// All that depends on the last evaluation alone, whatever the shift.
bool Programme::reduce_stages(Factorisation& result) {
    for (int n = 0; n < N && !(steps_known_ && residual_known_); ++n) {
        if (!steps_known_) {
            if (!reduce(n, result)) return result.bad_stage = n, false;
            reduce_hessian(n);
        }
        reduce_residual(n, rhs_);
    }
    step_pivot_ = result.smallest_pivot = steps_known_ ? step_pivot_ : result.smallest_pivot;
    return steps_known_ = residual_known_ = true;
}

// Factorises the step to node n + 1 and finds the reachable states there.
bool Programme::reduce(int n, Factorisation& result) {
    Stage& s = stages_[n];
    const Structure& t = *s.kind->structure;
    const double pivot = factor_step(n);
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    const StepFactor& before = n > 0 ? stages_[n - 1].step : s.step;
    for (int j = 0; j < t.d; ++j) s.chosen[j] = s.step.free[j], s.chosen[t.d + j] = t.nq + before.free[j];
    for (int j = 0; j < t.nr; ++j) s.chosen[2 * t.d + j] = 2 * t.nq + j;
    t.reach(s.step, step_before(n), space_.data());
    return true;
}

// xi = T (xi before, u), and half the stage's Hessian in these, the value function and the shift left out.
void Programme::reduce_hessian(int n) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const StepFactor *before = step_before(n), &now = s.step;
    const int nd = nd_, d = t.d, nq = t.nq, nu = k.nu;
    const int px = padded(nd), pm = padded(nd + nu), pd = padded(d), pu = padded(nu);
    Space space(space_.data());
    double *R = space.take(nq, pm), *beta = space.take(pd, pm), *S = space.zeros(k.ny, pd), *A = space.take(nq, pd);
    double *AK = space.zeros(pd, pd), *LB = space.zeros(ndx_, px), *LuB = space.zeros(pu, px);
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
        dense::zero(LB, ndx_ * px);
        t.times_basis(k.of_before_in_x, s.H, now, LB);
        t.project_matrix(*before, LB, product, px);
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < nd; ++j) E[i * pm + j] += product[j * px + i];
    }
    if (before && !k.of_before.empty()) {
        dense::zero(LB, ndx_ * px);
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
void Programme::reduce_residual(int n, const Residual& rhs) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const int nd = nd_, nu = k.nu, nw = k.nw(), ns = k.ns(), nx = ndx_, px = padded(nd);
    Space space(scratch_.data());
    double *z = space.zeros(nw + ns), *h = space.take(nw + ns), *none = space.zeros(padded(t.d)),
           *mm = space.take(t.nq);
    double *ds = z + nw, *hs = h + nw, *xi = space.zeros(px);
    if (n > 0) dense::copy(stages_[n - 1].b, ds, nx);
    dense::zero(s.t0, nw);
    t.Js.times(s.J, ds, s.t0, -1.0);
    for (int i = 0; i < nw; ++i) s.t0[i] -= rhs.c[m_offset[n] + i];
    solve_step(n, s.t0);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    dense::copy(s.t0, s.b, nx);
    t.expand(s.step, xi, s.b, -1.0);

    dense::copy(rhs.w.data() + m_offset[n], h, nw);
    dense::copy(rhs.s.data() + u_offset[n] + n * nx, hs, ns);
    dense::copy(s.t0, z, nw);
    k.hessian.times(s.H, z, h);
    t.momentum_multipliers(s.J, s.step, none, h + nx, mm, space_.data());  // of y's gradient
    t.respond_transposed(s.J, s.step, mm, hs);
    double* g = s.g + px;
    dense::zero(s.g, px + padded(nd + nu));
    t.project(s.step, h, s.g);
    if (n > 0) t.project(stages_[n - 1].step, hs, g);
    dense::copy(hs + nx, g + nd, nu);
}

// Value function of the last node, and the end condition's columns.
void Programme::reduce_end() {
    Stage& last = stages_.back();
    const Structure& t = *last.kind->structure;
    const int nx = ndx_, nd = nd_, px = padded(nd), pg = padded(ng_);
    Space space(space_.data());
    double *B = space.zeros(nx, px), *HB = space.zeros(nx, px), *column = space.take(nx), *sum = space.take(px);
    t.basis(last.step, B);
    for (int i = 0; i < nx; ++i)
        for (int j = 0; j < nx; ++j) {
            const double value = Hterm_[i * padded(nx) + j];
            if (value != 0.0) dense::axpy(px, value, B + j * px, HB + i * px);
        }
    dense::zero(last.P, px * px);
    t.project_matrix(last.step, HB, last.P, px);
    for (int i = 0; i < nd; ++i)
        for (int j = 0; j < i; ++j)
            last.P[i * px + j] = last.P[j * px + i] = 0.5 * (last.P[i * px + j] + last.P[j * px + i]);
    for (int g = 0; g < ng_; ++g) {
        for (int i = 0; i < nx; ++i) column[i] = Sterm_[i * pg + g];
        dense::zero(sum, px);
        t.project(last.step, column, sum);
        for (int i = 0; i < nd; ++i) last.S[i * pg + g] = sum[i];
    }
}

void Programme::backward_start_reduced(const Residual& rhs, Numbers& r) {
    Stage& last = stages_.back();
    const int nx = ndx_, pg = padded(ng_);
    dense::gemv_t(nx, ng_, Sterm_.data(), pg, last.b, r.data());  // g + S'b, and that is what is augmented
    double* slope = scratch_.data();
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), slope);
    dense::gemv(nx, nx, Hterm_.data(), padded(nx), last.b, slope);
    dense::gemv(nx, ng_, Sterm_.data(), pg, r.data(), slope, augment_);
    dense::zero(last.p, padded(nd_));
    last.kind->structure->project(last.step, slope, last.p);
}

bool Programme::condense_reduced(int n, Factorisation& result) {
    Stage& s = stages_[n];
    const int nd = nd_, nu = s.kind->nu, px = padded(nd), pm = padded(nd + nu), pg = padded(ng_);
    Space space(space_.data());
    double *P = space.zeros(px, px), *PT = space.zeros(px, pm), *W = space.take(pm, pm), *QS = space.take(pm, pg);
    double* kept = space.take(padded(nu), px);
    if (shift_ != 0.0) s.kind->structure->gram(s.step, P, px);
    for (int i = 0; i < px * px; ++i) P[i] = 0.5 * (shift_ * P[i] + s.P[i]);
    dense::gemm_nn(nd, pm, nd, P, px, s.T, pm, PT, pm);
    dense::copy(s.Q, W, pm * pm);
    dense::gemm_tn(nd + nu, pm, nd, s.T, pm, PT, pm, W, pm);
    if (ng_) {
        dense::zero(QS, pm * pg);
        dense::gemm_tn(nd + nu, ng_, nd, s.T, pm, s.S, pg, QS, pg);
    }
    const auto q = [&](int i, int j) { return W[i * pm + j] + W[j * pm + i]; };
    return eliminate_controls(n, q, QS, kept, result);
}

void Programme::backward_stage_reduced(int n, Numbers& r) {
    Stage& s = stages_[n];
    const int nd = nd_, nu = s.kind->nu, px = padded(nd), pm = padded(nd + nu), pg = padded(ng_);
    Space space(scratch_.data());
    double *q = space.take(pm), *xi = space.zeros(px), *gain = space.take(px), *shifted = space.zeros(px);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    if (shift_ != 0.0) s.kind->structure->project(s.step, s.t0, shifted);
    for (int i = 0; i < nd; ++i) gain[i] = s.p[i] + s.g[i] + shift_ * shifted[i];
    dense::gemv(nd, nd, s.P, px, xi, gain);
    dense::copy(s.g + px, q, pm);
    dense::gemv_t(nd, nd + nu, s.T, pm, gain, q);
    for (int i = 0; i < nu; ++i) s.k[i] = -q[nd + i];
    solve_controls(s, s.k);
    if (ng_) {
        dense::gemv_t(nd, ng_, s.S, pg, xi, r.data());
        dense::gemv_t(nu, ng_, s.Keta, pg, q + nd, r.data());
    }
    if (n > 0) {
        double* p = stages_[n - 1].p;
        dense::copy(q, p, nd);
        dense::gemv_t(nu, nd, s.K, px, q + nd, p);
    }
}

// States, controls, algebraic unknowns, and of the multipliers those of the momentum rows.
void Programme::forward_reduced(const Residual& rhs, Step& out) {
    const int nd = nd_, nx = ndx_, px = padded(nd), pg = padded(ng_);
    for (int n = 0; n < N; ++n) {
        Stage& s = stages_[n];
        const Kind& k = *s.kind;
        const Structure& t = *k.structure;
        const int nu = k.nu, nw = k.nw(), ns = k.ns(), pm = padded(nd + nu), d = t.d, pd = padded(d);
        Space space(scratch_.data());
        double *before = space.zeros(pm), *xi = space.zeros(px), *pi = space.take(px), *along = space.zeros(pd);
        double *z = space.take(nw + ns), *sum = space.take(nw), *dw = z, *ds = z + nw;
        const double* dx = out.dx.data() + static_cast<std::size_t>(n) * nx;
        double* du = out.du.data() + u_offset[n];
        if (n > 0)
            for (int i = 0; i < nd; ++i) before[i] = dx[stages_[n - 1].chosen[i]];
        dense::copy(s.k, du, nu);
        dense::gemv(nu, nd, s.K, px, before, du);
        dense::gemv(nu, ng_, s.Keta, pg, out.deta.data(), du);
        dense::copy(du, before + nd, nu);
        for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
        dense::gemv(nd, nd + nu, s.T, pm, before, xi);
        dense::copy(dx, ds, nx);
        dense::copy(du, ds + nx, nu);
        dense::copy(s.b, dw, nx);
        t.expand(s.step, xi, dw);
        t.balance(s.J, s.step, dw, ds, rhs.c.data() + m_offset[n] + t.nq, dw + nx, space_.data());
        dense::copy(dw, out.dx.data() + static_cast<std::size_t>(n + 1) * nx, nx);
        dense::copy(dw + nx, out.dy.data() + y_offset[n], k.ny);

        const double* w = rhs.w.data() + m_offset[n];
        dense::zero(s.Hz, nw + ns);
        k.hessian.times(s.H, z, s.Hz);
        dense::axpy(nx, shift_, dw, s.Hz);

        // Along the null space the costate's share is (dt, C')(P xi + p + S eta).
        dense::copy(s.p, pi, nd);
        dense::gemv(nd, nd, s.P, px, xi, pi);
        dense::gemv(nd, ng_, s.S, pg, out.deta.data(), pi);
        const double dt = s.step.dt;
        for (int i = 0; i < t.nq; ++i) sum[i] = -dt * (w[i] + s.Hz[i]) - w[t.nq + i] - s.Hz[t.nq + i];
        for (int j = 0; j < d; ++j) along[j] = -dt * pi[j];
        dense::gemv_t(t.nq, pd, s.step.N, pd, sum, along);
        for (int j = 0; j < d; ++j) dense::axpy(d, -pi[d + j], s.step.N + (s.chosen[d + j] - t.nq) * pd, along);
        for (int i = 0; i < k.ny; ++i) sum[i] = -w[nx + i] - s.Hz[nx + i];
        t.momentum_multipliers(s.J, s.step, along, sum, out.dm.data() + m_offset[n] + t.nq, space_.data());
    }
}

// The other multipliers, which need the whole costate of the node.
void Programme::multipliers_reduced(const Residual& rhs, Step& out) {
    const int nx = ndx_, pg = padded(ng_);
    double *costate = scratch_.data(), *b = costate + padded(nx + max_ns_), *mm = b + padded(max_nw_);
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), costate);
    dense::gemv(nx, nx, Hterm_.data(), padded(nx), out.dx.data() + static_cast<std::size_t>(N) * nx, costate);
    dense::gemv(nx, ng_, Sterm_.data(), pg, out.deta.data(), costate);
    for (int n = N - 1; n >= 0; --n) {
        Stage& s = stages_[n];
        const Kind& k = *s.kind;
        const Structure& t = *k.structure;
        double* dm = out.dm.data() + m_offset[n];
        const double *w = rhs.w.data() + m_offset[n], *of_s = rhs.s.data() + u_offset[n] + n * nx;
        for (int i = 0; i < k.nw(); ++i) b[i] = -w[i] - s.Hz[i] - (i < nx ? costate[i] : 0.0);
        dense::copy(dm + t.nq, mm, t.nq);
        t.other_multipliers(s.J, s.step, b, mm, space_.data());
        dense::copy(b, dm, k.nw());
        for (int i = 0; i < k.ns(); ++i) costate[i] = of_s[i] + s.Hz[k.nw() + i];
        t.Js.transposed_times(s.J, dm, costate);
    }
}

}  // namespace mbocp
