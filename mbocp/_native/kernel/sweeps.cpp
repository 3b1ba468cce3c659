// The staggered solvers' sweeps: state forward (eq. 29), adjoint backward (eq. 30, or eqs. 42-44), and the Hessian of
// the problem that is left when both are solved (the paper's K), column by column.
#include <stdexcept>

#include "programme.hpp"

namespace mbocp {
using dense::padded;

namespace {

constexpr double singular = 1e-15;  // relative pivot below which a step's matrix counts as singular

}  // namespace

// One implicit step by Newton's method, with the step halved where it gets worse: where the residual grows and the
// correction that the old derivatives ask for at the new point is no smaller, either (Deuflhard's natural monotonicity
// test). The residual alone would not do: its rows are momenta and constraints, and a good step along the tangent of a
// constraint turns the one into the other.
bool Programme::simulate_stage(int n, double tolerance, int max_iterations, bool warm, Sweep& sweep) {
    const Kind& k = *stages_[n].kind;
    StageFunction& f = *k.jacobian;
    const int nc = k.nc();
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
        bool better = norm <= before * (1.0 + 1e-3 * factor) + 1e3 * tolerance;
        if (finite && !better && has_direction) {
            double* simplified = direction + nc;
            dense::copy(c, simplified, nc);
            solve_step(n, simplified);
            double now = 0, then = 0;
            for (int i = 0; i < ndx_; ++i) now += simplified[i] * simplified[i], then += direction[i] * direction[i];
            better = std::sqrt(now) <= (1.0 - 0.25 * factor) * std::sqrt(then);
        }
        if (finite && better) {
            before = norm, factor = 1.0;
            std::copy(x1, x1 + nx_, x_before);
            std::copy(y1, y1 + k.ny, y_before);
            if (factor_step_of(n, f) == 0.0) return false;
            dense::copy(c, direction, nc);
            solve_step(n, direction);
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
    factorised_ = backward_done_ = steps_known_ = residual_known_ = false;
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
                feed_back(n, sweep_dx_.data(), u.data() + u_offset[n]);
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
    store_first_jacobian(n, f);
    for (std::size_t i = 0; i < k.to_first_gradient.size(); ++i)
        blocks[k.to_first_gradient[i].block][k.to_first_gradient[i].offset] = f.res[3][i];
    return ok;
}

// A_n of the auxiliary adjoint from what A_{n+1} leaves at the step's end, and its part of eq. (44) in `now`.
bool Programme::auxiliary_stage(int n, double* now) {
    const int nd = ndx_, nw = stages_[n].kind->nw(), ns = stages_[n].kind->ns(), ld = padded(nd);
    double *mine = A.data() + static_cast<std::size_t>(n) * nd * ng_, *left = auxiliary_S_.data();
    double *F = scratch_.data(), *column = F + nd * ld;
    std::vector<int> pivot(static_cast<std::size_t>(nd));
    copy_state_jacobian(n, F, ld);
    if (dense::lu_factor(nd, F, ld, pivot.data()) < singular) return false;
    Numbers rows(static_cast<std::size_t>(nw), 0.0), of_w(rows.size()), of_s(static_cast<std::size_t>(ns));
    for (int g = 0; g < ng_; ++g) {  // Eq. (42): F_x' A_{n-1} = -(what A_n leaves at x_n)
        for (int i = 0; i < nd; ++i) column[i] = -left[g * nd + i];
        dense::lu_solve_transposed(nd, F, ld, pivot.data(), column);
        for (int i = 0; i < nd; ++i) rows[i] = mine[i * ng_ + g] = column[i];
        std::fill(of_w.begin(), of_w.end(), 0.0), std::fill(of_s.begin(), of_s.end(), 0.0);
        add_jacobian_transposed(n, rows.data(), of_w.data(), of_s.data());
        for (int j = nd; j < nw; ++j) now[j] -= of_w[j] * eta[g];
        std::copy(of_s.begin(), of_s.begin() + nd, left + g * nd);
    }
    return true;
}

// Multipliers of stage n from what the later part of the Lagrangian says about x_n (`after`, all of it; with the
// auxiliary adjoint only sigma's share, A eta's being known). Leaves the share of x_{n-1} in gs.
bool Programme::adjoint_stage(int n, const double* after, bool auxiliary) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    const int nw = k.nw(), nd = ndx_;
    double* now = m.data() + m_offset[n];
    for (int i = 0; i < nw; ++i) now[i] = -s.lw[i] - (i < nd ? after[i] : 0.0);
    const double* mine = A.data() + static_cast<std::size_t>(n) * nd * ng_;
    if (auxiliary && !auxiliary_stage(n, now)) return false;
    if (factor_step(n) < singular) return false;
    solve_step_transposed(n, now);
    if (auxiliary) {  // Eq. (33)
        std::copy(now, now + nd, sigma.begin() + static_cast<std::ptrdiff_t>(n) * nd);
        for (int i = 0; i < nd; ++i)
            for (int g = 0; g < ng_; ++g) now[i] += mine[i * ng_ + g] * eta[g];
    }
    dense::copy(s.ls, s.gs, k.ns());
    dense::copy(s.lw, s.gw, nw);
    add_jacobian_transposed(n, now, s.gw, s.gs);
    return true;
}

// What the feedback makes of a deviation of the state: du += K dx.
void Programme::feed_back(int n, const double* dx, double* du) const {
    const Stage& s = stages_[n];
    if (!is_structured_) return dense::gemv(s.kind->nu, nd_, s.K, padded(nd_), dx, du);
    for (int j = 0; n > 0 && j < nd_; ++j)
        for (int i = 0; i < s.kind->nu; ++i) du[i] += s.K[i * padded(nd_) + j] * dx[stages_[n - 1].chosen[j]];
}

// And what a change of the control means through it: dx += K' du.
void Programme::close_loop(int n, const double* du, double* dx) const {
    const Stage& s = stages_[n];
    if (!is_structured_) return dense::gemv_t(s.kind->nu, nd_, s.K, padded(nd_), du, dx);
    for (int j = 0; n > 0 && j < nd_; ++j)
        for (int i = 0; i < s.kind->nu; ++i) dx[stages_[n - 1].chosen[j]] += s.K[i * padded(nd_) + j] * du[i];
}

Evaluation Programme::gradient(bool auxiliary, bool feedback) {
    Evaluation e;
    factorised_ = backward_done_ = steps_known_ = residual_known_ = false;
    bool ok = evaluate_terminal(e);
    if (auxiliary) {
        sigma.assign(static_cast<std::size_t>(N) * ndx_, 0.0);
        A.assign(static_cast<std::size_t>(N) * ndx_ * ng_, 0.0);
        auxiliary_S_.assign(static_cast<std::size_t>(ng_) * ndx_, 0.0);  // a row for each entry of eta
        for (int g = 0; g < ng_; ++g)
            for (int i = 0; i < ndx_; ++i) auxiliary_S_[g * ndx_ + i] = Sterm_[i * padded(ng_) + g];
    }
    Numbers after = auxiliary ? psix_ : rterm_;
    double squared = 0;
    for (int n = N - 1; n >= 0; --n) {
        const Stage& s = stages_[n];
        const Kind& k = *s.kind;
        ok = evaluate_first(n, e) && ok && adjoint_stage(n, after.data(), auxiliary);
        if (!ok) return e;
        dense::copy(s.gs, after.data(), ndx_);
        if (auxiliary && n > 0) dense::gemv_t(ng_, ndx_, auxiliary_S_.data(), ndx_, eta.data(), after.data(), -1.0);
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
    e.primal = std::sqrt(end), e.residual = std::sqrt(end + squared), e.objective = e.cost;
    e.finite = std::isfinite(e.residual) && std::isfinite(e.cost);
    return e;
}

Numbers Programme::end_sensitivity(bool feedback) {
    const int nd = ndx_, pg = padded(ng_), total = u_offset[N];
    Numbers out(static_cast<std::size_t>(ng_) * total, 0.0);
    Numbers p(nd), column(max_nw_), ds(max_ns_);
    for (int g = 0; g < ng_; ++g) {
        for (int i = 0; i < nd; ++i) p[i] = Sterm_[i * pg + g];
        for (int n = N - 1; n >= 0; --n) {
            const Kind& k = *stages_[n].kind;
            for (int i = 0; i < k.nc(); ++i) column[i] = i < nd ? -p[i] : 0.0;
            solve_step_transposed(n, column.data());
            double* du = out.data() + static_cast<std::size_t>(g) * total + u_offset[n];
            std::fill(ds.begin(), ds.end(), 0.0);
            add_jacobian_transposed(n, column.data(), nullptr, ds.data());
            std::copy(ds.begin(), ds.begin() + nd, p.begin());
            std::copy(ds.begin() + nd, ds.begin() + nd + k.nu, du);
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
    factorised_ = backward_done_ = steps_known_ = residual_known_ = false;
    for (Stage& s : stages_) {
        const Kind& k = *s.kind;
        const int ps = padded(k.ns());
        if (factor_step(static_cast<int>(&s - stages_.data())) < singular)
            throw std::runtime_error("reduced_hessian: the matrix of a step is singular");
        if (is_structured_) continue;
        dense::copy(s.Js, s.T, k.nc() * ps);
        solve_steps(static_cast<int>(&s - stages_.data()), s.T, ps);
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
            if (is_structured_) {
                k.structure->Js.times(s.J, ds, dw, -1.0);
                solve_step(n, dw);
            } else {
                dense::gemv(k.nw(), k.ns(), s.T, padded(k.ns()), ds, dw);
            }
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
            const int nw = k.nw(), ns = k.ns();
            dense::copy(d.dx.data() + static_cast<std::size_t>(n) * nd, ds, nd);
            dense::copy(d.du.data() + u_offset[n], ds + nd, k.nu);
            dense::copy(d.dx.data() + static_cast<std::size_t>(n + 1) * nd, dw, nd);
            dense::copy(d.dy.data() + y_offset[n], dw + nd, k.ny);
            dense::zero(dm, nw);
            dense::zero(hs, ns);
            add_hessian(n, dw, ds, dm, hs);
            for (int i = 0; i < nd; ++i) dm[i] += p[i] + shift * dw[i];
            for (int i = 0; i < nw; ++i) dm[i] = -dm[i];
            solve_step_transposed(n, dm);
            add_jacobian_transposed(n, dm, nullptr, hs);
            dense::copy(hs, p.data(), nd);
            dense::copy(hs + nd, out + ng_ + u_offset[n], k.nu);
        }
    }
    return K;
}

}  // namespace mbocp
