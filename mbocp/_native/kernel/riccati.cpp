// One Newton step of the whole horizon: condense each stage, walk backward (Riccati), then forward.
//
// The end condition's multiplier eta rides along as extra right-hand sides, which are the auxiliary adjoint A of
// eqs. (33)-(44) of the first paper; S below. Work and memory grow linearly with the number of stages.
//
// Propagating S with the open-loop dynamics is single shooting in disguise: on an unstable system its columns become
// parallel and the Schur complement of eta singular to working precision. The quadratic programme is therefore first
// augmented by rho/2 |g + g_x dx|^2, which changes neither its solution nor the inertia of its KKT matrix, but closes
// the loop: S then follows A + BK, and the Schur complement tends to -1/rho.
#include <algorithm>
#include <stdexcept>

#include "controls.hpp"

namespace mbocp {
using dense::padded;

bool Programme::condense(int n, Factorisation& result) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nw = k.nw(), ns = k.ns(), nc = k.nc(), nd = ndx_;
    const int pw = padded(nw), ps = padded(ns), px = padded(nd), pg = padded(ng_);

    // dw = T ds + t0 from the linearised step.
    const double pivot = factor_step(n);
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    dense::copy(s.Js, s.T, nc * ps);
    solve_steps(n, s.T, ps);
    if (!limits_.empty()) add_limits_to_value(n);

    // Q = Hss + T'(Hww + P)T + T'Hws + Hws'T, through one product by halving the middle term.
    double* Hhat = scratch_.data();
    double* M = Hhat + pw * pw;
    double* W = M + pw * ps;
    double* QS = W + ps * ps;
    for (int i = 0; i < nw * pw; ++i) Hhat[i] = 0.5 * s.Hww[i];
    for (int i = 0; i < nd; ++i) {
        for (int j = 0; j < nd; ++j) Hhat[i * pw + j] += 0.5 * s.P[i * px + j];
        Hhat[i * pw + i] += 0.5 * shift_;
    }
    dense::copy(s.Hws, M, pw * ps);
    dense::gemm_tn(nw, ns, nw, Hhat, pw, s.T, ps, M, ps);
    dense::zero(W, ps * ps);
    dense::gemm_tn(ns, ns, nw, s.T, ps, M, ps, W, ps);
    const auto q = [&](int i, int j) { return s.Hss[i * ps + j] + W[i * ps + j] + W[j * ps + i]; };
    if (ng_) {
        dense::zero(QS, ps * pg);
        dense::gemm_tn(ns, ng_, nd, s.T, ps, s.S, pg, QS, pg);
    }

    return eliminate_controls(n, q, QS, W, result);  // W's columns are free once q is no longer asked
}

Factorisation Programme::factorise(double shift, double augment) {
    Factorisation f;
    f.smallest_pivot = 1.0;
    shift_ = shift;
    Stage& last = stages_.back();
    augment_ = augment, factorised_ = false;
    backward_done_ = false;
    gather_residual(rhs_);
    if (is_structured_) {
        if (!reduce_stages(f)) return f;
        reduce_end();
    } else {
        dense::copy(Hterm_.data(), last.P, padded(ndx_) * padded(ndx_));
        if (ng_) dense::copy(Sterm_.data(), last.S, ndx_ * padded(ng_));
    }
    const int px = padded(nd_), pg = padded(ng_);
    for (int i = 0; i < nd_; ++i)
        for (int j = 0; j < nd_; ++j)
            for (int g = 0; g < ng_; ++g) last.P[i * px + j] += augment * last.S[i * pg + g] * last.S[j * pg + g];
    std::fill(R_.begin(), R_.end(), 0.0);
    backward_start(rhs_, eta_rhs_);
    for (int n = N - 1; n >= 0; --n) {
        if (!(is_structured_ ? condense_reduced(n, f) : condense(n, f))) {
            f.bad_stage = n;
            return f;
        }
        backward_stage(n, rhs_, eta_rhs_);  // a right-hand side at hand costs little while the blocks are in the cache
    }
    if (ng_) {  // eigenvectors of the equilibrated Schur complement: ng is small, and inertia comes for free
        RowMatrix R = MatrixMap(R_.data(), ng_, ng_, Eigen::OuterStride<>(pg));
        R = 0.5 * (R + R.transpose()).eval();
        Eigen::VectorXd scale(ng_);
        for (int i = 0; i < ng_; ++i) scale[i] = 1.0 / std::sqrt(std::max(std::abs(R(i, i)), 1e-300));
        R = scale.asDiagonal() * R * scale.asDiagonal();
        f.bad_stage = N;
        if (!R.allFinite()) return f;
        const Eigen::SelfAdjointEigenSolver<RowMatrix> eigen(R);
        const int negative = count_negative(eigen.eigenvalues());
        if (negative < 0) return f;
        f.negative += negative;
        f.end_condition = eigen.eigenvalues().cwiseAbs().minCoeff() / eigen.eigenvalues().cwiseAbs().maxCoeff();
        const RowMatrix inverse = scale.asDiagonal() * eigen.eigenvectors() *
                                  eigen.eigenvalues().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose() *
                                  scale.asDiagonal();
        R_factor_.assign(inverse.data(), inverse.data() + inverse.size());
    }
    f.bad_stage = -1, f.ok = factorised_ = backward_done_ = true;
    return f;
}

void Programme::gather_residual(Residual& out) const {
    for (int n = 0; n < N; ++n) {
        const Stage& s = stages_[n];
        const Kind& k = *s.kind;
        std::copy(s.c, s.c + k.nc(), out.c.begin() + m_offset[n]);
        std::copy(s.gw, s.gw + k.nw(), out.w.begin() + m_offset[n]);
        std::copy(s.gs, s.gs + k.ns(), out.s.begin() + u_offset[n] + n * ndx_);
    }
    out.x_terminal = rterm_;
    out.g = gterm_;
    if (!limits_.empty()) add_limit_gradients(out);
}

// The backward half of KKT * d = -rhs at stage n: t0, k and p from the right-hand side, and its share of r (eta's).
void Programme::backward_stage(int n, const Residual& rhs, Numbers& r) {
    if (is_structured_) return backward_stage_reduced(n, r);
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nd = ndx_, px = padded(nd), pg = padded(ng_);
    const int nw = k.nw(), ns = k.ns(), nc = k.nc(), nu = k.nu, pw = padded(nw), ps = padded(ns);
    double* h = scratch_.data();
    double* q = h + padded(max_nw_);
    for (int i = 0; i < nc; ++i) s.t0[i] = -rhs.c[m_offset[n] + i];
    solve_step(n, s.t0);
    dense::copy(rhs.w.data() + m_offset[n], h, nw);
    for (int i = 0; i < nd; ++i) h[i] += s.p[i];
    dense::gemv(nw, nw, s.Hww, pw, s.t0, h);
    dense::gemv(nd, nd, s.P, px, s.t0, h);
    for (int i = 0; i < nd; ++i) h[i] += shift_ * s.t0[i];
    dense::copy(rhs.s.data() + u_offset[n] + n * nd, q, ns);
    dense::gemv_t(nw, ns, s.T, ps, h, q);
    dense::gemv_t(nw, ns, s.Hws, ps, s.t0, q);
    for (int i = 0; i < nu; ++i) s.k[i] = -q[nd + i];
    solve_controls(s, s.k);
    if (ng_) {
        dense::gemv_t(nd, ng_, s.S, pg, s.t0, r.data());
        dense::gemv_t(nu, ng_, s.Keta, pg, q + nd, r.data());
    }
    if (n > 0) {
        double* p = stages_[n - 1].p;
        dense::copy(q, p, nd);
        dense::gemv_t(nu, nd, s.K, px, q + nd, p);
    }
}

void Programme::backward_start(const Residual& rhs, Numbers& r) {
    r = rhs.g;
    if (is_structured_) return backward_start_reduced(rhs, r);
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), stages_.back().p);
    dense::gemv(ndx_, ng_, Sterm_.data(), padded(ng_), rhs.g.data(), stages_.back().p, augment_);
}

void Programme::backward(const Residual& rhs, Numbers& r) {
    for (int n = 0; is_structured_ && n < N; ++n) reduce_residual(n, rhs);
    residual_known_ = false;
    backward_start(rhs, r);
    for (int n = N - 1; n >= 0; --n) backward_stage(n, rhs, r);
}

// The forward half; with `check` also rhs + KKT d, stage after stage while its blocks are in the cache.
void Programme::forward(const Residual& rhs, const Numbers& r, Step& out, Check* check) {
    const int nd = ndx_, px = padded(nd), pg = padded(ng_);
    double* h = scratch_.data();
    double* q = h + padded(max_nw_);
    std::fill(out.deta.begin(), out.deta.end(), 0.0);
    if (ng_) dense::gemv(ng_, ng_, R_factor_.data(), ng_, r.data(), out.deta.data(), -1.0);
    std::fill(out.dx.begin(), out.dx.begin() + nd, 0.0);
    if (is_structured_) {
        forward_reduced(rhs, out);
        multipliers_reduced(rhs, out);
        if (!check) return;
        check->knows_products = true;
        for (int n = 0; n < N; ++n) check_stage(n, rhs, out, *check);
        return check_end(rhs, out, *check);
    }
    for (int n = 0; n < N; ++n) {
        Stage& s = stages_[n];
        const Kind& k = *s.kind;
        const int nw = k.nw(), ns = k.ns(), nc = k.nc(), nu = k.nu, pw = padded(nw), ps = padded(ns);
        const double* dx = out.dx.data() + static_cast<std::size_t>(n) * nd;
        double* du = out.du.data() + u_offset[n];
        dense::copy(s.k, du, nu);
        dense::gemv(nu, nd, s.K, px, dx, du);
        dense::gemv(nu, ng_, s.Keta, pg, out.deta.data(), du);
        double* ds = q;
        dense::copy(dx, ds, nd);
        dense::copy(du, ds + nd, nu);
        double* dw = h;
        dense::copy(s.t0, dw, nw);
        dense::gemv(nw, ns, s.T, ps, ds, dw);
        double* dx_next = out.dx.data() + static_cast<std::size_t>(n + 1) * nd;
        dense::copy(dw, dx_next, nd);
        dense::copy(dw + nd, out.dy.data() + y_offset[n], k.ny);
        double* dm = out.dm.data() + m_offset[n];
        dense::copy(rhs.w.data() + m_offset[n], dm, nw);
        dense::gemv(nw, nw, s.Hww, pw, dw, dm);
        dense::gemv(nw, ns, s.Hws, ps, ds, dm);
        dense::gemv(nd, nd, s.P, px, dw, dm);
        for (int i = 0; i < nd; ++i) dm[i] += s.p[i] + shift_ * dw[i];
        dense::gemv(nd, ng_, s.S, pg, out.deta.data(), dm);
        for (int i = 0; i < nc; ++i) dm[i] = -dm[i];
        solve_step_transposed(n, dm);
        if (check) check_stage(n, rhs, out, *check);
    }
    if (check) check_end(rhs, out, *check);
}

// Rows of stage n in rhs + KKT d, into `left`; and d'Hd.
void Programme::check_stage(int n, const Residual& rhs, const Step& d, Check& check) {
    const int nd = ndx_;
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nw = k.nw(), ns = k.ns(), nc = k.nc(), nu = k.nu;
    double* ds = scratch_.data() + padded(max_nw_) + padded(max_ns_);
    double* dw = ds + padded(max_ns_);
    double* Hw = dw + padded(max_nw_);
    double* Hs = Hw + padded(max_nw_);
    Residual& out = check.left;
    dense::copy(d.dx.data() + static_cast<std::size_t>(n) * nd, ds, nd);
    dense::copy(d.du.data() + u_offset[n], ds + nd, nu);
    dense::copy(d.dx.data() + static_cast<std::size_t>(n + 1) * nd, dw, nd);
    dense::copy(d.dy.data() + y_offset[n], dw + nd, k.ny);
    double* c = out.c.data() + m_offset[n];
    dense::copy(rhs.c.data() + m_offset[n], c, nc);
    add_jacobian(n, dw, ds, c);
    dense::zero(Hw, nw);
    dense::zero(Hs, ns);
    if (check.knows_products) {
        dense::copy(s.Hz, Hw, nw), dense::copy(s.Hz + nw, Hs, ns);
    } else {
        add_hessian(n, dw, ds, Hw, Hs);
        for (int i = 0; i < nd; ++i) Hw[i] += shift_ * dw[i];
    }
    if (!limits_.empty()) add_limit_products(n, dw, ds + nd, Hw, Hs + nd);
    check.curvature += dense::dot(nw, dw, Hw) + dense::dot(ns, ds, Hs);
    double* w = out.w.data() + m_offset[n];
    for (int i = 0; i < nw; ++i) w[i] = rhs.w[m_offset[n] + i] + Hw[i];
    const double* dm = d.dm.data() + m_offset[n];
    double* r = out.s.data() + u_offset[n] + n * nd;
    for (int i = 0; i < ns; ++i) r[i] = rhs.s[u_offset[n] + n * nd + i] + Hs[i];
    add_jacobian_transposed(n, dm, w, r);
    if (n > 0) {  // both contributions to x_{n-1} belong to one row
        double* before = out.w.data() + m_offset[n - 1];
        for (int i = 0; i < nd; ++i) before[i] += r[i];
        check.largest = std::max(check.largest, dense::largest(nd, before));
    }
    std::fill(r, r + nd, 0.0);
    const double here = std::max(dense::largest(nw - nd, w + nd), dense::largest(nu, r + nd));
    check.largest = std::max({check.largest, dense::largest(nc, c), here});
}

void Programme::check_end(const Residual& rhs, const Step& d, Check& check) {
    const int nd = ndx_, px = padded(nd), pg = padded(ng_);
    const double* dx = d.dx.data() + static_cast<std::size_t>(N) * nd;
    double* last = check.left.w.data() + m_offset[N - 1];
    double* Hx = scratch_.data();
    dense::zero(Hx, nd);
    dense::gemv(nd, nd, Hterm_.data(), px, dx, Hx);
    for (int i = 0; i < nd; ++i) check.curvature += dx[i] * Hx[i], last[i] += Hx[i] + rhs.x_terminal[i];
    dense::gemv(nd, ng_, Sterm_.data(), pg, d.deta.data(), last);
    std::fill(check.left.x_terminal.begin(), check.left.x_terminal.end(), 0.0);
    check.left.g = rhs.g;
    dense::gemv_t(nd, ng_, Sterm_.data(), pg, dx, check.left.g.data());
    for (int i = 0; i < nd; ++i) check.largest = std::max(check.largest, std::abs(last[i]));
    for (const double v : check.left.g) check.largest = std::max(check.largest, std::abs(v));
}

Direction Programme::finish_direction(const Residual& rhs, int refinements) {
    Direction d;
    Check check{work_};
    if (!backward_done_) backward(rhs, eta_rhs_);
    backward_done_ = false;
    forward(rhs, eta_rhs_, step_, &check);
    double scale = 0;
    for (const Numbers* part : {&rhs.c, &rhs.w, &rhs.s, &rhs.g})
        scale = std::max(scale, dense::largest(static_cast<int>(part->size()), part->data()));
    for (int pass = 0;; ++pass) {
        d.linear_residual = scale > 0 ? check.largest / scale : check.largest, d.curvature = check.curvature;
        if (pass >= refinements || !(check.largest > 1e-11 * scale)) break;
        backward(work_, eta_rhs_);
        forward(work_, eta_rhs_, correction_, nullptr);
        const auto add = [](Numbers& to, const Numbers& from) {
            for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
        };
        add(step_.dx, correction_.dx), add(step_.dy, correction_.dy), add(step_.du, correction_.du);
        add(step_.dm, correction_.dm), add(step_.deta, correction_.deta);
        check.largest = check.curvature = 0, check.knows_products = false;
        for (int n = 0; n < N; ++n) check_stage(n, rhs, step_, check);
        check_end(rhs, step_, check);
    }
    double squared = 0;
    for (int n = 0; n < N; ++n) {
        const Stage& s = stages_[n];
        const Kind& k = *s.kind;
        const double* dx0 = step_.dx.data() + static_cast<std::size_t>(n) * ndx_;
        const double* dx1 = dx0 + ndx_;
        squared += dense::dot(ndx_, dx1, dx1);
        d.slope += dense::dot(ndx_, s.lw, dx1) + dense::dot(ndx_, s.ls, dx0);
        for (int i = 0; i < k.ny; ++i) {
            const double v = step_.dy[y_offset[n] + i];
            squared += v * k.scale_y[i] * v * k.scale_y[i];
            d.slope += s.lw[ndx_ + i] * v;
        }
        for (int i = 0; i < k.nu; ++i) {
            const double v = step_.du[u_offset[n] + i];
            squared += v * v;
            d.slope += s.ls[ndx_ + i] * v;
        }
        for (int i = 0; i < k.nc(); ++i) {
            const double v = step_.dm[m_offset[n] + i] * k.scale_m[i];
            squared += v * v;
        }
    }
    for (int i = 0; i < ndx_; ++i) d.slope += psix_[i] * step_.dx[static_cast<std::size_t>(N) * ndx_ + i];
    for (const double v : step_.deta) squared += v * v;
    if (!limits_.empty()) find_limit_step(d);
    d.increment = std::sqrt(squared);
    d.finite = std::isfinite(d.increment) && std::isfinite(d.linear_residual);
    return d;
}

Direction Programme::solve(int refinements) {
    if (!factorised_) throw std::logic_error("solve: the last factorisation failed or is missing");
    if (!backward_done_) gather_residual(rhs_);
    return finish_direction(rhs_, refinements);
}

Direction Programme::correct(double alpha) {
    if (!factorised_) throw std::logic_error("correct: the last factorisation failed or is missing");
    backward_done_ = false;
    gather_residual(rhs_);
    for (std::size_t i = 0; i < rhs_.c.size(); ++i) rhs_.c[i] = alpha * rhs_.c[i] + c_trial_[i];
    for (std::size_t i = 0; i < rhs_.g.size(); ++i) rhs_.g[i] = alpha * rhs_.g[i] + g_trial_[i];
    return finish_direction(rhs_, 0);
}

}  // namespace mbocp
