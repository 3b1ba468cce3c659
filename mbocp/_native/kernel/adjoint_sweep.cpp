#include "adjoint_sweep.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {
using dense::padded;

AdjointSweep::AdjointSweep(const Problem& problem, Iterate& iterate, Data& data, Step& step, const Elimination& gains)
    : problem_(problem), iterate_(iterate), data_(data), step_(step), gains_(gains) {
    const std::size_t nd = problem.ndx, ld = padded(problem.ndx);
    work_.allocate(nd * ld + 2 * nd + 2 * static_cast<std::size_t>(problem.kind().nw() + problem.kind().ns()) + 64);
}

bool AdjointSweep::evaluate_stage(int n, Evaluation& e) {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    StageFunction& f = *k.jacobian;
    const bool ok = problem_.call(f, n, iterate_);
    double* const gradients[] = {s.lw, s.ls};
    e.cost += f.outputs[1].nnz() ? f.res[1][0] : 0.0;
    for (int i = 0; i < f.outputs[0].nnz(); ++i) s.c[f.outputs[0].row[i]] = f.res[0][i];
    step_.store_first(n, f);
    for (std::size_t i = 0; i < k.to_first_gradient.size(); ++i)
        gradients[k.to_first_gradient[i].block][k.to_first_gradient[i].offset] = f.res[3][i];
    return ok;
}

// A_n of the auxiliary adjoint from what A_{n+1} leaves at the step's end, and its part of eq. (44) in `now`.
bool AdjointSweep::find_auxiliary(int n, double* now) {
    const int nd = problem_.ndx, ng = problem_.ng, nw = problem_.kind().nw(), ns = problem_.kind().ns();
    const int ld = padded(nd);
    Space space(work_.data());
    double *F = space.take(nd, ld), *column = space.take(nd), *rows = space.zeros(nw), *of_w = space.take(nw);
    double *of_s = space.take(ns), *mine = A.data() + static_cast<std::size_t>(n) * nd * ng;
    std::vector<int> pivot(static_cast<std::size_t>(nd));
    step_.copy_state_jacobian(n, F, ld);
    if (dense::lu_factor(nd, F, ld, pivot.data()) < singular) return false;
    for (int g = 0; g < ng; ++g) {  // Eq. (42): F_x' A_{n-1} = -(what A_n leaves at x_n)
        for (int i = 0; i < nd; ++i) column[i] = -S_[g * nd + i];
        dense::lu_solve_transposed(nd, F, ld, pivot.data(), column);
        for (int i = 0; i < nd; ++i) rows[i] = mine[i * ng + g] = column[i];
        dense::zero(of_w, nw), dense::zero(of_s, ns);
        step_.add_jacobian_transposed(n, rows, of_w, of_s);
        for (int j = nd; j < nw; ++j) now[j] -= of_w[j] * iterate_.eta[g];
        std::copy(of_s, of_s + nd, S_.begin() + g * nd);
    }
    return true;
}

// Multipliers of stage n from what the later part of the Lagrangian says about x_n (`after`, all of it; with the
// auxiliary adjoint only sigma's share, A eta's being known). Leaves the share of x_{n-1} in gs.
bool AdjointSweep::find_multipliers(int n, const double* after, bool auxiliary) {
    const Stage& s = data_[n];
    const int nw = s.kind->nw(), nd = problem_.ndx, ng = problem_.ng;
    double* now = iterate_.m.data() + problem_.m_offset[n];
    for (int i = 0; i < nw; ++i) now[i] = -s.lw[i] - (i < nd ? after[i] : 0.0);
    if (auxiliary && !find_auxiliary(n, now)) return false;
    if (step_.factor(n) < singular) return false;
    step_.solve_transposed(n, now);
    if (auxiliary) {  // Eq. (33)
        const double* mine = A.data() + static_cast<std::size_t>(n) * nd * ng;
        std::copy(now, now + nd, sigma.data() + static_cast<std::size_t>(n) * nd);
        for (int i = 0; i < nd; ++i)
            for (int g = 0; g < ng; ++g) now[i] += mine[i * ng + g] * iterate_.eta[g];
    }
    dense::copy(s.ls, s.gs, s.kind->ns());
    dense::copy(s.lw, s.gw, nw);
    step_.add_jacobian_transposed(n, now, s.gw, s.gs);
    return true;
}

Evaluation AdjointSweep::run(bool auxiliary, bool feedback) {
    Evaluation e;
    const int N = problem_.N, nd = problem_.ndx, ng = problem_.ng;
    const End& end = data_.end;
    bool ok = data_.end.evaluate(problem_, iterate_, e);
    if (auxiliary) {
        sigma.assign(static_cast<std::size_t>(N) * nd, 0.0);
        A.assign(static_cast<std::size_t>(N) * nd * ng, 0.0);
        S_.assign(static_cast<std::size_t>(ng) * nd, 0.0);
        for (int g = 0; g < ng; ++g)
            for (int i = 0; i < nd; ++i) S_[g * nd + i] = end.S[i * padded(ng) + g];
    }
    Numbers after = auxiliary ? end.psi_x : end.r_x;
    double squared = 0;
    for (int n = N - 1; n >= 0; --n) {
        const Stage& s = data_[n];
        ok = evaluate_stage(n, e) && ok && find_multipliers(n, after.data(), auxiliary);
        if (!ok) return e;
        dense::copy(s.gs, after.data(), nd);
        if (auxiliary && n > 0) dense::gemv_t(ng, nd, S_.data(), nd, iterate_.eta.data(), after.data(), -1.0);
        if (feedback) gains_.feed_back_transposed(n, s.gs + nd, after.data());
        for (int i = 0; i < s.kind->nu; ++i) {
            const double v = s.gs[nd + i] * s.kind->scale_ru[i];
            squared += v * v;
        }
    }
    measure_end(e, squared);
    return e;
}

// What is left of the evaluation, the squared norm of the control gradients being known.
void AdjointSweep::measure_end(Evaluation& e, double squared) const {
    double end = 0;
    const Numbers& g = data_.end.g;
    for (int i = 0; i < problem_.ng; ++i) {
        e.violation += std::abs(g[i]);
        end += g[i] * g[i];
        if (!(std::abs(g[i]) <= e.worst)) e.worst = std::abs(g[i]), e.worst_row = i;
    }
    e.dual = std::sqrt(squared), e.primal = std::sqrt(end);
    e.residual = std::sqrt(end + squared), e.objective = e.cost;
    e.finite = std::isfinite(e.residual) && std::isfinite(e.cost);
}

Numbers AdjointSweep::end_sensitivity(bool feedback) {
    const int nd = problem_.ndx, ng = problem_.ng, pg = padded(ng), total = problem_.u_offset[problem_.N];
    Numbers out(static_cast<std::size_t>(ng) * total, 0.0);
    Space space(work_.data());
    double *p = space.take(nd), *column = space.take(problem_.kind().nw()), *ds = space.take(problem_.kind().ns());
    for (int g = 0; g < ng; ++g) {
        for (int i = 0; i < nd; ++i) p[i] = data_.end.S[i * pg + g];
        for (int n = problem_.N - 1; n >= 0; --n) {
            const Kind& k = problem_.kind();
            for (int i = 0; i < k.nc(); ++i) column[i] = i < nd ? -p[i] : 0.0;
            step_.solve_transposed(n, column);
            double* du = out.data() + static_cast<std::size_t>(g) * total + problem_.u_offset[n];
            dense::zero(ds, k.ns());
            step_.add_jacobian_transposed(n, column, nullptr, ds);
            std::copy(ds, ds + nd, p);
            std::copy(ds + nd, ds + nd + k.nu, du);
            if (feedback) gains_.feed_back_transposed(n, du, p);
        }
    }
    return out;
}

}  // namespace mbocp
