// The staggered solvers' sweeps: state forward (eq. 29), adjoint backward (eq. 30, or eqs. 42-44), and the Hessian of
// the problem that is left when both are solved (the paper's K), column by column.
#include <stdexcept>

#include "programme.hpp"

namespace mbocp {
using dense::padded;

namespace {

constexpr double singular = 1e-15;  // relative pivot below which a step's matrix counts as singular

}  // namespace

// One implicit step by Newton's method, with the step halved where the residual grows.
bool Programme::simulate_stage(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    StageFunction& f = *k.jacobian;
    const int nc = k.nc(), ld = padded(k.nw());
    double* x1 = x.data() + static_cast<std::size_t>(n + 1) * nx_;
    double* y1 = y.data() + y_offset[n];
    if (!warm) {
        std::copy(x1 - nx_, x1, x1);
        if (n > 0 && y_offset[n] - y_offset[n - 1] == k.ny) std::copy(y1 - k.ny, y1, y1);
    }
    double* c = sweep_c_.data();
    double* direction = c + nc;
    double* x_before = sweep_before_.data();
    double* y_before = x_before + nx_;
    bool has_direction = false;
    double norm = INFINITY, before = INFINITY, factor = 1.0;
    for (int iteration = 0; iteration <= max_iterations; ++iteration, ++sweep.iterations) {
        bind(f, n, x, y, u);
        f.arg[4] = theta_.data();
        f.arg[5] = rho_.data() + r_offset[n];
        const bool ok = f.call();
        dense::zero(c, nc);
        for (int i = 0; i < f.outputs[0].nnz(); ++i) c[f.outputs[0].row[i]] = f.res[0][i];
        norm = 0;
        for (int i = 0; i < nc; ++i) norm = std::max(norm, std::isfinite(c[i]) ? std::abs(c[i]) : INFINITY);
        const bool finite = ok && std::isfinite(norm);
        sweep.residual = std::max(sweep.residual, norm);
        if (finite && norm <= tolerance) return sweep.residual = norm, true;
        // A full step at the level of round-off cannot improve further.
        if (finite && iteration > 3 && norm < 1e4 * tolerance && norm >= before && factor == 1.0)
            return sweep.residual = norm, true;
        if (finite && norm <= before * (1.0 + 1e-3 * factor) + 1e3 * tolerance) {
            before = norm, factor = 1.0;
            std::copy(x1, x1 + nx_, x_before);
            std::copy(y1, y1 + k.ny, y_before);
            dense::zero(s.LU, nc * ld);
            for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
                if (k.to_first_jacobian[i].block == JW) s.LU[k.to_first_jacobian[i].offset] = f.res[2][i];
            if (dense::lu_factor(nc, s.LU, ld, s.pivot) == 0.0) return false;
            dense::copy(c, direction, nc);
            dense::lu_solve_vector(nc, s.LU, ld, s.pivot, direction);
            has_direction = true;
        } else if ((factor *= 0.5) < 1e-6 || !has_direction) {
            return false;
        }
        for (int i = 0; i < ndx_; ++i) sweep_dx_[i] = -direction[i];
        if (!retract_into(x_before, sweep_dx_.data(), factor, x1)) return false;
        for (int i = 0; i < k.ny; ++i) y1[i] = y_before[i] - factor * direction[ndx_ + i];
    }
    return false;
}

Sweep Programme::simulate(double tolerance, int max_iterations, bool warm, bool feedback) {
    Sweep sweep;
    double largest = 0;
    factorised_ = backward_done_ = false;
    double* planned = planned_.data();  // x_n before it is swept, and x_{n+1} likewise
    double* next = planned + nx_;
    for (int n = 0; n < N; ++n) {
        sweep.residual = 0;
        if (feedback) {
            const double* now = x.data() + static_cast<std::size_t>(n) * nx_;
            if (n > 0) {
                difference_->arg[0] = planned, difference_->arg[1] = now;
                if (!difference_->call()) {
                    sweep.failed_stage = n;
                    return sweep;
                }
                std::fill(sweep_dx_.begin(), sweep_dx_.end(), 0.0);
                const Pattern& pattern = difference_->outputs[0];
                for (int i = 0; i < pattern.nnz(); ++i) sweep_dx_[pattern.row[i]] = difference_->res[0][i];
                const Stage& s = stages_[n];
                dense::gemv(s.kind->nu, ndx_, s.K, padded(ndx_), sweep_dx_.data(), u.data() + u_offset[n]);
            }
            std::copy(now + nx_, now + 2 * nx_, next);
            std::swap(planned, next);
        }
        bool ok = simulate_stage(n, tolerance, max_iterations, warm, sweep);
        if (!ok && warm) ok = simulate_stage(n, tolerance, max_iterations, false, sweep);
        if (!ok) {
            sweep.failed_stage = n;
            return sweep;
        }
        largest = std::max(largest, sweep.residual);
    }
    sweep.residual = largest, sweep.ok = true;
    return sweep;
}

bool Programme::evaluate_first(int n, Evaluation& e) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    StageFunction& f = *k.jacobian;
    bind(f, n, x, y, u);
    f.arg[4] = theta_.data();
    f.arg[5] = rho_.data() + r_offset[n];
    const bool ok = f.call();
    e.cost += f.outputs[1].nnz() ? f.res[1][0] : 0.0;
    double* blocks[] = {s.Jw, s.Js, s.Hww, s.Hws, s.Hss, s.lw, s.ls};
    for (int i = 0; i < f.outputs[0].nnz(); ++i) s.c[f.outputs[0].row[i]] = f.res[0][i];
    for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
        blocks[k.to_first_jacobian[i].block][k.to_first_jacobian[i].offset] = f.res[2][i];
    for (std::size_t i = 0; i < k.to_first_gradient.size(); ++i)
        blocks[k.to_first_gradient[i].block][k.to_first_gradient[i].offset] = f.res[3][i];
    return ok;
}

// Multipliers of stage n from what the later part of the Lagrangian says about x_n (`after`, all of it; with the
// auxiliary adjoint only sigma's share, A eta's being known). Leaves the share of x_{n-1} in gs.
bool Programme::adjoint_stage(int n, const double* after, bool auxiliary) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nc = k.nc(), nw = k.nw(), ns = k.ns(), nd = ndx_, pw = padded(nw), ps = padded(ns), pg = padded(ng_);
    double* now = m.data() + m_offset[n];
    for (int i = 0; i < nw; ++i) now[i] = -s.lw[i] - (i < nd ? after[i] : 0.0);
    double* mine = A.data() + static_cast<std::size_t>(n) * nd * ng_;
    if (auxiliary) {  // Eq. (42): F_x' A_{n-1} = -(what A_n leaves at x_n), in S; then its part of eq. (44)
        double* F = scratch_.data();
        double* column = F + nd * padded(nd);
        for (int i = 0; i < nd; ++i) dense::copy(s.Jw + i * pw, F + i * padded(nd), nd);
        if (dense::lu_factor(nd, F, padded(nd), s.pivot) < singular) return false;
        for (int g = 0; g < ng_; ++g) {
            for (int i = 0; i < nd; ++i) column[i] = -s.S[i * pg + g];
            dense::lu_solve_transposed(nd, F, padded(nd), s.pivot, column);
            for (int i = 0; i < nd; ++i) mine[i * ng_ + g] = column[i];
        }
        for (int i = 0; i < nd; ++i) {
            double total = 0;  // (A eta)_i
            for (int g = 0; g < ng_; ++g) total += mine[i * ng_ + g] * eta[g];
            for (int j = nd; j < nw; ++j) now[j] -= s.Jw[i * pw + j] * total;
        }
        if (n > 0) {
            double* S = stages_[n - 1].S;
            dense::zero(S, nd * pg);
            for (int i = 0; i < nd; ++i)
                for (int j = 0; j < nd; ++j)
                    for (int g = 0; g < ng_; ++g) S[j * pg + g] += s.Js[i * ps + j] * mine[i * ng_ + g];
        }
    }
    dense::copy(s.Jw, s.LU, nc * pw);
    if (dense::lu_factor(nc, s.LU, pw, s.pivot) < singular) return false;
    dense::lu_solve_transposed(nc, s.LU, pw, s.pivot, now);
    if (auxiliary) {  // Eq. (33)
        std::copy(now, now + nd, sigma.begin() + static_cast<std::ptrdiff_t>(n) * nd);
        for (int i = 0; i < nd; ++i)
            for (int g = 0; g < ng_; ++g) now[i] += mine[i * ng_ + g] * eta[g];
    }
    dense::copy(s.ls, s.gs, ns);
    dense::gemv_t(nc, ns, s.Js, ps, now, s.gs);
    dense::copy(s.lw, s.gw, nw);
    dense::gemv_t(nc, nw, s.Jw, pw, now, s.gw);
    return true;
}

// What a change of the state means through the feedback: dx += K' du.
void Programme::close_loop(int n, const double* du, double* dx) const {
    dense::gemv_t(stages_[n].kind->nu, ndx_, stages_[n].K, padded(ndx_), du, dx);
}

Evaluation Programme::gradient(bool auxiliary, bool feedback) {
    Evaluation e;
    factorised_ = backward_done_ = false;
    bool ok = evaluate_terminal(e);
    if (auxiliary) {
        sigma.assign(static_cast<std::size_t>(N) * ndx_, 0.0);
        A.assign(static_cast<std::size_t>(N) * ndx_ * ng_, 0.0);
        if (ng_) dense::copy(Sterm_.data(), stages_.back().S, ndx_ * padded(ng_));
    }
    Numbers after = auxiliary ? psix_ : rterm_;
    double squared = 0;
    for (int n = N - 1; n >= 0; --n) {
        const Stage& s = stages_[n];
        const Kind& k = *s.kind;
        ok = evaluate_first(n, e) && ok && adjoint_stage(n, after.data(), auxiliary);
        if (!ok) return e;
        dense::copy(s.gs, after.data(), ndx_);
        if (auxiliary && n > 0)
            dense::gemv(ndx_, ng_, stages_[n - 1].S, padded(ng_), eta.data(), after.data(), -1.0);
        if (feedback) close_loop(n, s.gs + ndx_, after.data());
        for (int i = 0; i < k.nu; ++i) {
            const double v = s.gs[ndx_ + i] * k.scale_ru[i];
            squared += v * v;
        }
    }
    e.dual = std::sqrt(squared);
    double end = 0;
    for (int i = 0; i < ng_; ++i) {
        e.violation += std::abs(gterm_[i]);
        end += gterm_[i] * gterm_[i];
        if (!(std::abs(gterm_[i]) <= e.worst)) e.worst = std::abs(gterm_[i]), e.worst_row = i;
    }
    e.primal = std::sqrt(end), e.residual = std::sqrt(end + squared);
    e.finite = std::isfinite(e.residual) && std::isfinite(e.cost);
    return e;
}

Numbers Programme::end_sensitivity(bool feedback) {
    const int nd = ndx_, pg = padded(ng_), total = u_offset[N];
    Numbers out(static_cast<std::size_t>(ng_) * total, 0.0);
    Numbers p(nd), column(max_nw_);
    for (int g = 0; g < ng_; ++g) {
        for (int i = 0; i < nd; ++i) p[i] = Sterm_[i * pg + g];
        for (int n = N - 1; n >= 0; --n) {
            const Stage& s = stages_[n];
            const Kind& k = *s.kind;
            const int nc = k.nc(), ps = padded(k.ns());
            for (int i = 0; i < nc; ++i) column[i] = i < nd ? -p[i] : 0.0;
            dense::lu_solve_transposed(nc, s.LU, padded(k.nw()), s.pivot, column.data());
            double* du = out.data() + static_cast<std::size_t>(g) * total + u_offset[n];
            std::fill(p.begin(), p.end(), 0.0);
            for (int i = 0; i < nc; ++i) {
                dense::axpy(nd, column[i], s.Js + i * ps, p.data());
                dense::axpy(k.nu, column[i], s.Js + i * ps + nd, du);
            }
            if (feedback) close_loop(n, du, p.data());
        }
    }
    return out;
}

Numbers Programme::costates() const {
    Numbers out;
    for (const Stage& s : stages_) out.insert(out.end(), s.gs, s.gs + ndx_);
    out.insert(out.end(), rterm_.begin(), rterm_.end());
    return out;
}

Numbers Programme::control_gradient() const {
    Numbers out;
    for (const Stage& s : stages_)
        for (int i = 0; i < s.kind->nu; ++i) out.push_back(s.gs[ndx_ + i] * s.kind->scale_ru[i]);
    return out;
}

Numbers Programme::control_scale() const {
    Numbers out;
    for (const Stage& s : stages_) out.insert(out.end(), s.kind->scale_ru.begin(), s.kind->scale_ru.end());
    return out;
}

Numbers Programme::reduced_hessian(double shift) {
    const int nd = ndx_, px = padded(nd), pg = padded(ng_);
    const int total = ng_ + u_offset[N];
    factorised_ = backward_done_ = false;
    for (Stage& s : stages_) {
        const Kind& k = *s.kind;
        const int pw = padded(k.nw()), ps = padded(k.ns());
        dense::copy(s.Jw, s.LU, k.nc() * pw);
        if (dense::lu_factor(k.nc(), s.LU, pw, s.pivot) < singular)
            throw std::runtime_error("reduced_hessian: the matrix of a step is singular");
        for (int i = 0; i < k.nc() * ps; ++i) s.T[i] = -s.Js[i];
        dense::lu_solve(k.nc(), s.LU, pw, s.pivot, s.T, ps, ps);
    }
    Numbers K(static_cast<std::size_t>(total) * total, 0.0);
    Step d = step_;
    for (int column = 0; column < total; ++column) {
        double* out = K.data() + static_cast<std::size_t>(column) * total;  // symmetric: rows are columns
        std::fill(d.deta.begin(), d.deta.end(), 0.0), std::fill(d.du.begin(), d.du.end(), 0.0);
        (column < ng_ ? d.deta[column] : d.du[column - ng_]) = 1.0;
        // State: dw = T ds from the first stage on that moves.
        std::fill(d.dx.begin(), d.dx.end(), 0.0), std::fill(d.dy.begin(), d.dy.end(), 0.0);
        int first = N;
        if (column >= ng_)
            for (first = 0; u_offset[first + 1] <= column - ng_;) ++first;
        double* ds = scratch_.data();
        double* dw = ds + padded(max_ns_);
        for (int n = first; n < N; ++n) {
            const Stage& s = stages_[n];
            const Kind& k = *s.kind;
            dense::copy(d.dx.data() + static_cast<std::size_t>(n) * nd, ds, nd);
            dense::copy(d.du.data() + u_offset[n], ds + nd, k.nu);
            dense::zero(dw, k.nw());
            dense::gemv(k.nw(), k.ns(), s.T, padded(k.ns()), ds, dw);
            dense::copy(dw, d.dx.data() + static_cast<std::size_t>(n + 1) * nd, nd);
            dense::copy(dw + nd, d.dy.data() + y_offset[n], k.ny);
        }
        // End condition and adjoint, from the end.
        const double* dx_end = d.dx.data() + static_cast<std::size_t>(N) * nd;
        for (int g = 0; g < ng_; ++g) out[g] = 0.0;
        dense::gemv_t(nd, ng_, Sterm_.data(), pg, dx_end, out);
        Numbers& p = sweep_dx_;
        std::fill(p.begin(), p.end(), 0.0);
        dense::gemv(nd, nd, Hterm_.data(), px, dx_end, p.data());
        dense::gemv(nd, ng_, Sterm_.data(), pg, d.deta.data(), p.data());
        double* dm = dw + padded(max_nw_);
        double* hs = dm + padded(max_nw_);
        for (int n = N - 1; n >= 0; --n) {
            const Stage& s = stages_[n];
            const Kind& k = *s.kind;
            const int nw = k.nw(), ns = k.ns(), pw = padded(nw), ps = padded(ns);
            dense::copy(d.dx.data() + static_cast<std::size_t>(n) * nd, ds, nd);
            dense::copy(d.du.data() + u_offset[n], ds + nd, k.nu);
            dense::copy(d.dx.data() + static_cast<std::size_t>(n + 1) * nd, dw, nd);
            dense::copy(d.dy.data() + y_offset[n], dw + nd, k.ny);
            dense::zero(dm, nw);
            dense::gemv(nw, nw, s.Hww, pw, dw, dm);
            dense::gemv(nw, ns, s.Hws, ps, ds, dm);
            for (int i = 0; i < nd; ++i) dm[i] += p[i] + shift * dw[i];
            for (int i = 0; i < nw; ++i) dm[i] = -dm[i];
            dense::lu_solve_transposed(k.nc(), s.LU, pw, s.pivot, dm);
            dense::zero(hs, ns);
            dense::gemv(ns, ns, s.Hss, ps, ds, hs);
            dense::gemv_t(nw, ns, s.Hws, ps, dw, hs);
            dense::gemv_t(k.nc(), ns, s.Js, ps, dm, hs);
            dense::copy(hs, p.data(), nd);
            dense::copy(hs + nd, out + ng_ + u_offset[n], k.nu);
        }
    }
    return K;
}

}  // namespace mbocp
