// The Newton step of stages with a structure: value functions over the reachable states alone.
//
// Whatever the controls, the linearised constraints and kinematics of the steps up to node n leave
//
//   dq_n = N_n alpha,   dv_n = N_{n-1} gamma + V_n alpha,   V_n = (N_n - N_{n-1} C_n) / dt,   C_n = N_n[E_{n-1}]
//
// and a part b_n that follows from the residuals of the two steps before. As N[E] is the identity, the coordinates
// xi = (alpha, gamma) are entries of dx_n themselves: dq_n[E_n] and dv_n[E_{n-1}]. With dx = B xi + b the Riccati
// recursion is that of 2 d entries, d the degrees of freedom, instead of all of the state's.
//
// The multipliers need the whole costate, of which the value function knows B' times it. That is enough for the momentum
// rows; the others follow from them backwards, stage by stage, without a recursion that could grow.
#include "controls.hpp"

namespace mbocp {
using dense::padded;

// Factorises the step to node n + 1 and finds the reachable states there.
bool Programme::reduce(int n, Factorisation& result) {
    Stage& s = stages_[n];
    const Structure& t = *s.kind->structure;
    const double pivot = factor_step(n);
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    const StepFactor &now = s.step, &before = stages_[n > 0 ? n - 1 : 0].step;
    const int nq = t.nq, d = t.d, pd = padded(d), px = padded(nd_);
    for (int j = 0; j < d; ++j) s.chosen[j] = now.free[j], s.chosen[d + j] = nq + before.free[j];
    for (int j = 0; j < t.nr; ++j) s.chosen[2 * d + j] = 2 * nq + j;
    dense::zero(s.B, ndx_ * px);
    double *C = space_.data(), *V = C + padded(d) * pd;
    dense::zero(C, padded(d) * pd);
    for (int j = 0; j < d; ++j) dense::copy(now.N + before.free[j] * pd, C + j * pd, pd);
    dense::copy(now.N, V, nq * pd);
    dense::gemm_nn(nq, d, d, before.N, pd, C, pd, V, pd, -1.0);
    for (int i = 0; i < nq; ++i) {
        double *in_q = s.B + i * px, *in_v = s.B + (nq + i) * px;
        for (int j = 0; j < d; ++j) {
            in_q[j] = now.N[i * pd + j];
            in_v[j] = n > 0 ? V[i * pd + j] / now.dt : 0.0;
            in_v[d + j] = before.N[i * pd + j];
        }
    }
    for (int j = 0; j < t.nr; ++j) s.B[(2 * nq + j) * px + 2 * d + j] = 1.0;
    return true;
}

// b of all nodes from the residuals of kinematics and constraints.
void Programme::particular_states(const Residual& rhs) {
    for (int n = 0; n < N; ++n) {
        Stage& s = stages_[n];
        const Structure& t = *s.kind->structure;
        const StepFactor& before = stages_[n > 0 ? n - 1 : 0].step;
        const int nq = t.nq, d = t.d, pd = padded(d);
        const double* c = rhs.c.data() + m_offset[n];
        double *bq = s.b, *bv = s.b + nq, *along = space_.data();
        t.particular(s.J, s.step, c + ndx_, -1.0, bq, space_.data());
        for (int i = 0; i < nq; ++i) bv[i] = (bq[i] - (n > 0 ? stages_[n - 1].b[i] : 0.0) - c[i]) / s.step.dt;
        for (int j = 0; j < d; ++j) along[j] = bv[before.free[j]];
        dense::gemv(nq, d, before.N, pd, along, bv, -1.0);
    }
}

// Value function of the last node, and the end condition's columns.
void Programme::reduce_end() {
    Stage& last = stages_.back();
    const int nx = ndx_, nd = nd_, px = padded(nd), pg = padded(ng_);
    double* PB = space_.data();
    dense::zero(PB, nx * px);
    dense::gemm_nn(nx, nd, nx, Hterm_.data(), padded(nx), last.B, px, PB, px);
    dense::zero(last.P, px * px);
    dense::gemm_tn(nd, nd, nx, last.B, px, PB, px, last.P, px);
    for (int i = 0; i < nd; ++i) {
        for (int j = 0; j < i; ++j)
            last.P[i * px + j] = last.P[j * px + i] = 0.5 * (last.P[i * px + j] + last.P[j * px + i]);
        for (int g = 0; g < ng_; ++g) {
            double sum = 0;
            for (int c = 0; c < nx; ++c) sum += last.B[c * px + i] * Sterm_[c * pg + g];
            last.S[i * pg + g] = sum;
        }
    }
}

void Programme::backward_start_reduced(const Residual& rhs, Numbers& r) {
    particular_states(rhs);
    Stage& last = stages_.back();
    const int nx = ndx_, pg = padded(ng_);
    dense::gemv_t(nx, ng_, Sterm_.data(), pg, last.b, r.data());  // g + S'b, and that is what is augmented
    double* slope = scratch_.data();
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), slope);
    dense::gemv(nx, nx, Hterm_.data(), padded(nx), last.b, slope);
    dense::gemv(nx, ng_, Sterm_.data(), pg, r.data(), slope, augment_);
    dense::zero(last.p, nd_);
    dense::gemv_t(nx, nd_, last.B, padded(nd_), slope, last.p);
}

bool Programme::condense_reduced(int n, Factorisation& result) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const Structure& t = *k.structure;
    const int nd = nd_, nu = k.nu, ny = k.ny, nw = k.nw(), nx = ndx_, others = ny + nx + nu;
    const int px = padded(nd), pm = padded(nd + nu), pg = padded(ng_);
    double* Z = space_.data();  // (w, s) from (xi before, u); its rows after x are `others`
    double* O = Z + nx * pm;
    double* HO = O + others * pm;  // what the others contribute in x, and among themselves
    double* HB = HO + (nx + others) * pm;
    double* P = HB + nx * px;
    double* W = P + px * px;
    double* QS = W + pm * pm;
    double* PT = QS + pm * pg;
    double* kept = PT + px * pm;
    double* work = kept + padded(nu) * px;

    double* Zs = Z + nw * pm;
    dense::zero(Z, (nx + others) * pm);
    if (n > 0)  // x_0 is given
        for (int i = 0; i < nx; ++i) dense::copy(stages_[n - 1].B + i * px, Zs + i * pm, nd);
    for (int i = 0; i < nu; ++i) Zs[(nx + i) * pm + nd + i] = 1.0;
    double* T = s.T;  // xi from (xi before, u), then y
    if (!steps_known_) {
        t.Js.times_matrix(s.J, Zs, pm, Z, -1.0);
        t.solve(s.J, s.step, Z, pm, false, work);
        for (int i = 0; i < nd; ++i) dense::copy(Z + s.chosen[i] * pm, T + i * pm, pm);
        dense::copy(O, T + nd * pm, ny * pm);
    } else {
        dense::copy(T + nd * pm, O, ny * pm);
    }

    // Half the quadratic form, W with Q = W + W': in xi through x = B xi, first P + B'(Hxx + shift)B.
    dense::zero(HB, nx * px);
    k.Uxx.times_matrix(s.H, s.B, px, HB);
    if (shift_ != 0.0) dense::axpy(nx * px, 0.5 * shift_, s.B, HB);
    for (int i = 0; i < px * px; ++i) P[i] = 0.5 * s.P[i];
    dense::gemm_tn(nd, nd, nx, s.B, px, HB, px, P, px);
    dense::zero(PT, px * pm);
    dense::gemm_nn(nd, pm, nd, P, px, T, pm, PT, pm);
    dense::zero(HO, (nx + others) * pm);
    k.Uxo.times_matrix(s.H, O, pm, HO);
    dense::gemm_tn(nd, pm, k.coupled_rows, s.B, px, HO, pm, PT, pm);
    dense::zero(W, pm * pm);
    dense::gemm_tn(nd + nu, pm, nd, T, pm, PT, pm, W, pm);
    double* HOO = HO + nx * pm;
    k.Uoo.times_matrix(s.H, O, pm, HOO);
    dense::gemm_tn(nd + nu, pm, k.other_rows, O, pm, HOO, pm, W, pm);
    for (int i = 0; i < nu; ++i) dense::axpy(pm, 1.0, HOO + (ny + nx + i) * pm, W + (nd + i) * pm);
    const auto q = [&](int i, int j) { return W[i * pm + j] + W[j * pm + i]; };
    if (ng_) {
        dense::zero(QS, pm * pg);
        dense::gemm_tn(nd + nu, ng_, nd, T, pm, s.S, pg, QS, pg);
    }
    return eliminate_controls(n, q, QS, kept, result);
}

void Programme::backward_stage_reduced(int n, const Residual& rhs, Numbers& r) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nd = nd_, nu = k.nu, nw = k.nw(), ns = k.ns(), nx = ndx_;
    const int px = padded(nd), pm = padded(nd + nu), pg = padded(ng_);
    double *ds = scratch_.data(), *h = ds + padded(ns), *q = h + padded(nw + ns), *xi = q + pm, *gain = xi + px;
    dense::zero(ds, ns);
    if (n > 0) dense::copy(stages_[n - 1].b, ds, nx);
    dense::zero(s.t0, nw);
    k.structure->Js.times(s.J, ds, s.t0, -1.0);
    for (int i = 0; i < nw; ++i) s.t0[i] -= rhs.c[m_offset[n] + i];
    solve_step(n, s.t0);
    dense::copy(rhs.w.data() + m_offset[n], h, nw);
    dense::copy(rhs.s.data() + u_offset[n] + n * nx, h + nw, ns);
    add_hessian(n, s.t0, ds, h, h + nw);
    dense::axpy(nx, shift_, s.t0, h);
    for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
    dense::copy(s.p, gain, nd);
    dense::gemv(nd, nd, s.P, px, xi, gain);
    dense::gemv_t(nx, nd, s.B, px, h, gain);
    dense::zero(q, pm);
    dense::gemv_t(nd, nd + nu, s.T, pm, gain, q);
    dense::gemv_t(k.ny, nd + nu, s.T + nd * pm, pm, h + nx, q);
    if (n > 0) dense::gemv_t(nx, nd, stages_[n - 1].B, px, h + nw, q);
    for (int i = 0; i < nu; ++i) q[nd + i] += h[nw + nx + i];
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
        double *before = scratch_.data(), *dw = before + pm, *xi = dw + padded(nw), *pi = xi + px, *along = pi + px;
        double* sum = along + pd;
        const double* dx = out.dx.data() + static_cast<std::size_t>(n) * nx;
        double *du = out.du.data() + u_offset[n], *ds = sum + padded(nw);
        dense::zero(before, pm);
        if (n > 0)
            for (int i = 0; i < nd; ++i) before[i] = dx[stages_[n - 1].chosen[i]];
        dense::copy(s.k, du, nu);
        dense::gemv(nu, nd, s.K, px, before, du);
        dense::gemv(nu, ng_, s.Keta, pg, out.deta.data(), du);
        dense::copy(du, before + nd, nu);
        for (int i = 0; i < nd; ++i) xi[i] = s.t0[s.chosen[i]];
        dense::gemv(nd, nd + nu, s.T, pm, before, xi);
        dense::copy(s.b, dw, nx);
        dense::gemv(nx, nd, s.B, px, xi, dw);
        dense::copy(s.t0 + nx, dw + nx, k.ny);
        dense::gemv(k.ny, nd + nu, s.T + nd * pm, pm, before, dw + nx);
        dense::copy(dw, out.dx.data() + static_cast<std::size_t>(n + 1) * nx, nx);
        dense::copy(dw + nx, out.dy.data() + y_offset[n], k.ny);

        const double* w = rhs.w.data() + m_offset[n];
        dense::zero(s.Hz, nw + ns);
        dense::copy(dx, ds, nx);
        dense::copy(du, ds + nx, nu);
        add_hessian(n, dw, ds, s.Hz, s.Hz + nw);
        dense::axpy(nx, shift_, dw, s.Hz);

        // Along the null space the costate's share is (dt, C')(P xi + p + S eta).
        dense::copy(s.p, pi, nd);
        dense::gemv(nd, nd, s.P, px, xi, pi);
        dense::gemv(nd, ng_, s.S, pg, out.deta.data(), pi);
        const double dt = s.step.dt;
        for (int i = 0; i < t.nq; ++i) sum[i] = -dt * (w[i] + s.Hz[i]) - w[t.nq + i] - s.Hz[t.nq + i];
        for (int j = 0; j < d; ++j) along[j] = -dt * pi[j];
        dense::gemv_t(t.nq, d, s.step.N, pd, sum, along);
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
