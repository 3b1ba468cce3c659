#include "dense_elimination.hpp"

#include <algorithm>

#include "structured_elimination.hpp"

namespace mbocp {
using dense::padded;

std::unique_ptr<Elimination> make_elimination(const Problem& problem, Data& data, Step& step, Barrier& barrier,
                                              EndMultiplier& eta) {
    if (problem.is_structured()) return std::make_unique<StructuredElimination>(problem, data, step, barrier, eta);
    return std::make_unique<DenseElimination>(problem, data, step, barrier, eta);
}

DenseElimination::DenseElimination(const Problem& problem, Data& data, Step& step, Barrier& barrier, EndMultiplier& eta)
    : problem_(problem), data_(data), step_(step), barrier_(barrier), controls_(problem, data, barrier, eta) {
    const std::size_t pw = padded(problem.max_nw), ps = padded(problem.max_ns), pg = padded(problem.ng);
    work_.allocate(2 * pw * pw + (2 * pw + ps) * (pg + ps) + 2 * pw + 2 * ps + 96);
    vectors_.allocate(pw + ps + 16);
    pivots_.assign(static_cast<std::size_t>(problem.N), -1.0);
}

bool DenseElimination::start(const Residual&, Factorisation&) {
    const Stage& last = data_.last();
    const int px = padded(problem_.ndx), pg = padded(problem_.ng);
    dense::copy(data_.end.H.data(), last.P, px * px);
    if (problem_.ng) dense::copy(data_.end.S.data(), last.S, problem_.ndx * pg);
    if (problem_.crew().size() > 1) std::fill(pivots_.begin(), pivots_.end(), -1.0);
    return true;
}

bool DenseElimination::condense(int n, const Weights& weights, Factorisation& result) {
    const Stage& s = data_[n];
    // dw = T ds + t0 from the linearised step.
    const double pivot = pivots_[n] < 0.0 ? step_.prepare_response(n, 0) : pivots_[n];
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    const int nd = problem_.ndx, ps = padded(s.kind->ns());
    if (!barrier_.empty()) barrier_.add_to_value(n, s.P);
    if (barrier_.has_equations()) barrier_.learn(n, s.T, s.Hss, ps, nd);
    const Form form = s.factors_of == StepFactors::rest ? form_of_rest(s, weights.shift) : whole_form(s, weights.shift);
    dense::symmetrise(s.kind->ns(), form.at + padded(problem_.ng), form.ld, s.Hss, ps);
    return controls_.eliminate(n, form, result);
}

// Half of Hww + P, the latter shifted.
void DenseElimination::add_up(const Stage& s, double shift, double* H) const {
    const int nd = problem_.ndx, nw = s.kind->nw(), pw = padded(nw), px = padded(nd);
    dense::scaled(nw * pw, 0.5, s.Hww, H);
    for (int i = 0; i < nd; ++i) {
        dense::axpy(nd, 0.5, s.P + i * px, H + i * pw);
        H[i * pw + i] += 0.5 * shift;
    }
}

// Q = Hss + T'(Hww + P)T + T'Hws + Hws'T, through one product by halving the middle term, and T'S beside it: half of
// this, Q - Hss being the sum of the half and its transpose.
Form DenseElimination::whole_form(const Stage& s, double shift) {
    const int nd = problem_.ndx, nw = s.kind->nw(), ns = s.kind->ns(), ny = s.kind->ny;
    const int pw = padded(nw), ps = padded(ns), pg = padded(problem_.ng), ld = pg + ps;
    Space space(work_.data());
    // Rows that a product rounds its result up to come behind those of M.
    double *H = space.take(nw, pw), *M = space.take(pw + dense::width, ps), *Q = space.zeros(ps, ld);
    add_up(s, shift, H);
    dense::copy(s.Hws, M, nw * ps);
    if (s.kind->has_split_hessian) {
        double* of_y = M + nd * ps;
        dense::gemm_tn(ny, ns, ny, H + nd * (pw + 1), pw, s.T + nd * ps, ps, of_y, ps);
        dense::gemm_tn(nd, ns, nd, H, pw, s.T, ps, M, ps);
    } else {
        dense::gemm_tn(nw, ns, nw, H, pw, s.T, ps, M, ps);
    }
    if (problem_.ng) dense::gemm_tn(ns, pg, nd, s.T, ps, s.S, pg, Q, ld);
    dense::gemm_tn(ns, ns, nw, s.T, ps, M, ps, Q + pg, ld);
    return {Q, ld};
}

// The same where w = (a, z) with a = D z + J s. With z = V s, L = [D; 1] and halves H of the Hessian:
//
//   V'(L'H L V + 2 L'(H J) + L'Hws) + J'(H J + Hws), and V'L'S + J'S
//
// up to what its transpose has. J has the identity or little more, so products are as deep as z is long.
Form DenseElimination::form_of_rest(const Stage& s, double shift) {
    const Kind& k = *s.kind;
    const int nd = problem_.ndx, nw = k.nw(), ns = k.ns(), na = k.num_direct, nz = nw - na;
    const int pw = padded(nw), ps = padded(ns), pg = padded(problem_.ng), pz = padded(nz), ld = pg + ps;
    Space space(work_.data());
    double *H = space.take(nw, pw), *M = space.take(pw, ld), *Q = space.zeros(ps, ld);
    double *B = space.take(pw), *D = space.zeros(pw), *J = space.zeros(ps), *twice_J = space.zeros(ps),
           *G = space.zeros(pz, pz), *rows = space.take(na, ld);
    add_up(s, shift, H);
    for (int i = 0; i < na; ++i) D[i] = s.Jw[i * (pw + 1) + na], J[i] = s.Js[i * (ps + 1)], twice_J[i] = 2.0 * J[i];
    for (int i = 0; i < nz; ++i) {
        double* m = M + i * ld;
        na + i < nd ? dense::copy(s.S + (na + i) * pg, m, pg) : dense::zero(m, pg);
        dense::copy(s.Hws + (na + i) * ps, m + pg, ps);
        dense::copy(H + (na + i) * pw, B, pw);  // row i of L'H
        if (i < na) {
            dense::axpy(pg, D[i], s.S + i * pg, m);
            dense::axpy(ps, D[i], s.Hws + i * ps, m + pg);
            dense::axpy(pw, D[i], H + i * pw, B);
        }
        dense::copy(B + na, G + i * pz, nz);
        dense::multiply_add(na, D, B, G + i * pz);
        dense::multiply_add(na, twice_J, B, m + pg);
        for (const auto& [row, column] : k.before) m[pg + column] += 2.0 * s.Js[row * ps + column] * B[row];
    }
    dense::gemm_tn(nz, ns, nz, G, pz, s.T + na * ps, ps, M + pg, ld);
    for (int i = 0; i < na; ++i) {  // of J'(S | H J + Hws): what the identity in J has, and the rest
        double* q = Q + i * ld;
        dense::copy(s.S + i * pg, q, pg), dense::copy(s.Hws + i * ps, q + pg, ps);
        dense::multiply_add(na, J, H + i * pw, q + pg);
        for (const auto& [row, column] : k.before) q[pg + column] += s.Js[row * ps + column] * H[i * pw + row];
    }
    if (!k.before.empty()) dense::copy(Q, rows, na * ld);
    for (int i = 0; i < na; ++i)
        if (J[i] != 1.0) dense::scaled(ld, J[i], Q + i * ld, Q + i * ld);
    for (const auto& [row, column] : k.before)
        dense::axpy(ld, s.Js[row * ps + column], rows + row * ld, Q + column * ld);
    dense::gemm_tn(ns, ld, nz, s.T + na * ps, ps, M, ld, Q, ld);
    return {Q, ld};
}

void DenseElimination::start_backward(const Residual& rhs, const Weights& weights, Numbers& r) {
    r = rhs.g;
    double* p = data_.last().p;
    const int ng = problem_.ng;
    std::copy(rhs.x_terminal.begin(), rhs.x_terminal.end(), p);
    dense::gemv(problem_.ndx, ng, data_.end.S.data(), padded(ng), rhs.g.data(), p, weights.augment);
}

void DenseElimination::backward(int n, const Residual& rhs, const Weights& weights, Numbers& r) {
    const Stage& s = data_[n];
    const int nd = problem_.ndx, ng = problem_.ng, nw = s.kind->nw(), ns = s.kind->ns(), nu = s.kind->nu;
    const int pw = padded(nw), ps = padded(ns), px = padded(nd), pg = padded(ng);
    const double* c = rhs.c.data() + problem_.m_offset[n];
    Space space(vectors_.data());
    double *h = space.take(nw), *q = space.take(ns);
    for (int i = 0; i < s.kind->nc(); ++i) s.t0[i] = -c[i];
    step_.solve(n, s.t0);
    dense::copy(rhs.w.data() + problem_.m_offset[n], h, nw);
    for (int i = 0; i < nd; ++i) h[i] += s.p[i];
    dense::gemv(nw, nw, s.Hww, pw, s.t0, h);
    dense::gemv(nd, nd, s.P, px, s.t0, h);
    for (int i = 0; i < nd; ++i) h[i] += weights.shift * s.t0[i];
    dense::copy(rhs.s.data() + problem_.s_offset(n), q, ns);
    dense::gemv_t(nw, ns, s.T, ps, h, q);
    dense::gemv_t(nw, ns, s.Hws, ps, s.t0, q);
    for (int i = 0; i < nu; ++i) s.k[i] = -q[nd + i];
    controls_.solve(s, s.k);
    if (ng) {
        dense::gemv_t(nd, ng, s.S, pg, s.t0, r.data());
        dense::gemv_t(nu, ng, s.Keta, pg, q + nd, r.data());
    }
    if (n == 0) return;
    double* p = data_[n - 1].p;
    dense::copy(q, p, nd);
    dense::gemv_t(nu, nd, s.K, px, q + nd, p);
}

void DenseElimination::forward(const Residual& rhs, const Weights& weights, Increment& out, KktCheck* check) {
    const auto turn = [&](int n) { forward_stage(n, rhs, weights, out); };
    const auto verify = [&](int n) { check->add_stage(n, rhs, out, weights.shift); };
    Crew& crew = problem_.crew();
    const bool may_share = check && crew.size() > 1;
    if (may_share && section_.begin()) {
        behind_.start();
        crew.together([&](int thread) {
            if (thread == 1) behind_.help(verify);
            for (int n = 0; thread == 0 && n < problem_.N; ++n) turn(n), behind_.allow(n + 1);
            if (thread == 0) behind_.finish(problem_.N, verify);
        });
    } else {
        for (int n = 0; n < problem_.N; ++n) {
            turn(n);
            if (check) verify(n);
        }
    }
    if (may_share) section_.end();
    if (check) check->add_end(rhs, out);
}

void DenseElimination::forward_stage(int n, const Residual& rhs, const Weights& weights, Increment& out) {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    const int nd = problem_.ndx, ng = problem_.ng, nw = k.nw(), ns = k.ns(), nu = k.nu;
    const int pw = padded(nw), ps = padded(ns), px = padded(nd), pg = padded(ng);
    Space space(work_.data());
    double *dw = space.take(nw), *ds = space.take(ns);
    const double* dx = out.dx.data() + problem_.dx_offset(n);
    double *du = out.du.data() + problem_.u_offset[n], *dm = out.dm.data() + problem_.m_offset[n];
    dense::copy(s.k, du, nu);
    dense::gemv(nu, nd, s.K, px, dx, du);
    dense::gemv(nu, ng, s.Keta, pg, out.deta.data(), du);
    dense::copy(dx, ds, nd);
    dense::copy(du, ds + nd, nu);
    dense::copy(s.t0, dw, nw);
    dense::gemv(nw, ns, s.T, ps, ds, dw);
    dense::copy(dw, out.dx.data() + problem_.dx_offset(n + 1), nd);
    dense::copy(dw + nd, out.dy.data() + problem_.y_offset[n], k.ny);
    dense::copy(rhs.w.data() + problem_.m_offset[n], dm, nw);
    dense::gemv(nw, nw, s.Hww, pw, dw, dm);
    dense::gemv(nw, ns, s.Hws, ps, ds, dm);
    dense::gemv(nd, nd, s.P, px, dw, dm);
    for (int i = 0; i < nd; ++i) dm[i] += s.p[i] + weights.shift * dw[i];
    dense::gemv(nd, ng, s.S, pg, out.deta.data(), dm);
    for (int i = 0; i < k.nc(); ++i) dm[i] = -dm[i];
    step_.solve_transposed(n, dm);
}

void DenseElimination::feed_back(int n, const double* dx, double* du) const {
    const Stage& s = data_[n];
    dense::gemv(s.kind->nu, problem_.nd, s.K, padded(problem_.nd), dx, du);
}

void DenseElimination::feed_back_transposed(int n, const double* du, double* dx) const {
    const Stage& s = data_[n];
    dense::gemv_t(s.kind->nu, problem_.nd, s.K, padded(problem_.nd), du, dx);
}

}  // namespace mbocp
