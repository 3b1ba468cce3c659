#include "dense_elimination.hpp"

#include <algorithm>

#include "dense_step.hpp"
#include "followers.hpp"
#include "structured_elimination.hpp"

namespace mbocp {
using dense::padded;

namespace {

// B += A where A has entries.
void add_box(const Box& box, const double* A, int lda, double* B, int ldb) {
    A += box.row * lda + box.column, B += box.row * ldb + box.column;
    dense::for_tiles(padded(box.columns) / dense::width, [&](auto V, int j) {
        for (int i = 0; i < box.rows; ++i)
            for (int v = j; v < j + dense::width * V(); v += dense::width)
                dense::store(B + i * ldb + v, dense::load(B + i * ldb + v) + dense::load(A + i * lda + v));
    });
}

}  // namespace

std::unique_ptr<Elimination> make_elimination(const Problem& problem, Data& data, Step& step, Barrier& barrier,
                                              EndMultiplier& eta) {
    if (problem.is_structured()) return std::make_unique<StructuredElimination>(problem, data, step, barrier, eta);
    return std::make_unique<DenseElimination>(problem, data, step, barrier, eta);
}

DenseElimination::DenseElimination(const Problem& problem, Data& data, Step& step, Barrier& barrier, EndMultiplier& eta)
    : problem_(problem), data_(data), step_(step), barrier_(barrier), controls_(problem, data, barrier, eta) {
    const std::size_t pw = padded(problem.kind().nw()), ps = padded(problem.kind().ns()), pg = padded(problem.ng);
    // Of a form: its rows, H, B, M, G, Y, and J'(...); see below.
    work_.allocate((3 * pw + 1) * pw + (3 * pw + ps + 12) * (pg + ps) + 4 * pw + 4 * ps + 128);
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

void DenseElimination::learn() {
    for (int n = 0; n < problem_.N; ++n) {
        if (!barrier_.has_equations(n)) continue;
        condense_ahead(n, 0);
        if (pivots_[n] >= singular) learn(n);
    }
}

void DenseElimination::learn(int n) {
    const Stage& s = data_[n];
    complete_response(s);
    barrier_.learn(n, s.T, s.Hss, padded(s.kind->ns()), problem_.ndx);
}

bool DenseElimination::condense(int n, const Weights& weights, Factorisation& result) {
    const Stage& s = data_[n];
    // dw = T ds + t0 from the linearised step.
    const double pivot = pivots_[n] < 0.0 ? step_.prepare_response(n, 0) : pivots_[n];
    result.smallest_pivot = std::min(result.smallest_pivot, pivot);
    if (pivot < singular) return false;
    if (!barrier_.empty()) barrier_.add_to_value(n, s.P);
    if (barrier_.has_equations(n)) learn(n);
    if (s.factors_of == StepFactors::others) return controls_.eliminate(n, form_of_others(s, weights.shift), result);
    if (s.factors_of != StepFactors::rest) return controls_.eliminate(n, whole_form(s, weights.shift), result);
    const auto form = [&](auto joints) { return form_of_rest<joints()>(s, weights.shift); };
    return controls_.eliminate(n, dense::for_few(s.kind->joints(), form), result);
}

// Hww + P, the latter shifted.
template <int Joints>
void DenseElimination::add_up(const Stage& s, double shift, double* H) const {
    const int nd = Joints ? 2 * Joints : problem_.ndx, nw = Joints ? 2 * Joints : s.kind->nw();
    const int pw = padded(nw), px = padded(nd);
    for (int i = 0; i < nd; ++i) {
        dense::copy(s.P + i * px, H + i * pw, px);
        dense::zero(H + i * pw + px, pw - px);
    }
    for (int i = 0; i < nd && shift != 0.0; ++i) H[i * pw + i] += shift;
    dense::zero(H + nd * pw, (nw - nd) * pw);
    for (const Box& box : {s.kind->of_Hww_state, s.kind->of_Hww_rest}) add_box(box, s.Hww, pw, H, pw);
}

// Controls' rows behind those of the state, or, unless these are to be connected, behind the rows that a product rounds
// its result up to.
Form DenseElimination::take_form(const Kind& k, Space& space, bool is_connected) const {
    const int nd = problem_.ndx, ld = padded(problem_.ng) + padded(k.ns()), first = is_connected ? nd : padded(nd);
    double* rows = space.take(first + padded(k.nu) + dense::width, ld);
    return {rows, rows + first * ld, ld};
}

void DenseElimination::add_hessian(const Stage& s, const Form& form) const {
    const Kind& k = *s.kind;
    const int ps = padded(k.ns()), pg = padded(problem_.ng);
    add_box(k.of_Hss_state, s.Hss, ps, form.of_state + pg, form.ld);
    add_box(k.of_Hss_controls, s.Hss + problem_.ndx * ps, ps, form.of_controls + pg, form.ld);
}

// Q = Hss + T'(Hww + P)T + T'Hws + Hws'T, and T'S beside it.
Form DenseElimination::whole_form(const Stage& s, double shift) {
    const Kind& k = *s.kind;
    const int nd = problem_.ndx, nw = k.nw(), ns = k.ns(), ny = k.ny, nu = k.nu;
    const int pw = padded(nw), ps = padded(ns), pg = padded(problem_.ng);
    Space space(work_.data());
    const Form form = take_form(k, space);
    const int ld = form.ld;
    double *H = space.take(nw, pw), *M = space.take(pw + dense::width, ps), *of_y = M + nd * ps;
    add_up<0>(s, shift, H);
    // What a product rounds its rows up to comes before the rows that are there.
    if (k.has_split_hessian) {
        dense::gemm_tn<0, false>(nd, ns, nd, H, pw, s.T, ps, M, ps);
        dense::gemm_tn<0, false>(ny, ns, ny, H + nd * (pw + 1), pw, s.T + nd * ps, ps, of_y, ps);
    } else {
        dense::gemm_tn<0, false>(nw, ns, nw, H, pw, s.T, ps, M, ps);
    }
    add_box(k.of_Hws, s.Hws, ps, M, ps);
    dense::gemm_tn<0, false>(nd, pg, nd, s.T, ps, s.S, pg, form.of_state, ld);
    dense::gemm_tn<0, false>(nu, pg, nd, s.T + nd, ps, s.S, pg, form.of_controls, ld);
    dense::gemm_tn<0, false>(nu, ns, nw, s.T + nd, ps, M, ps, form.of_controls + pg, ld);
    if (k.couples_controls) dense::gemm_tn(nu, ns, nw, s.Hws + nd, ps, s.T, ps, form.of_controls + pg, ld);
    add_box(k.of_Hws, s.Hws, ps, M, ps);
    dense::gemm_tn<0, false>(nd, nd, nw, s.T, ps, M, ps, form.of_state + pg, ld);
    add_hessian(s, form);
    return form;
}

// The same where w = (a, z) with a = D z + J s. With z = V s, L = [D; 1], H = Hww + P and Y = L'(H J + Hws):
//
//   V'(L'H L V + Y) + Y'V + J'(H J + Hws) + Hws'J + Hss, and V'L'S + J'S
//
// J has the identity or little more, so products are as deep as z is long. Where Y and J know no controls, the
// controls' rows have but the first term, and with 2 Y in place of Y the state's have the right symmetric part; else
// all is added up by halves and their transposes.
template <int Joints>
Form DenseElimination::form_of_rest(const Stage& s, double shift) {
    const Kind& k = *s.kind;
    const int na = Joints ? Joints : k.num_direct, nd = Joints ? 2 * na : problem_.ndx, nw = Joints ? 2 * na : k.nw();
    const int nz = nw - na, ns = nd + k.nu, nu = k.nu, pw = padded(nw), pd = padded(nd), pz = padded(nz);
    const int ps = padded(ns), pg = padded(problem_.ng), ny = k.couples_controls ? ps : pd;
    const double part = k.couples_controls ? 0.5 : 1.0, *V = s.T + na * ps;
    Space space(work_.data());
    const Form form = take_form(k, space, k.couples_controls);
    const int ld = form.ld;
    dense::zero(form.of_state, (k.couples_controls ? padded(nd + nu) : pd) * ld);
    double *H = space.take(nw + 1, pw), *M = space.take(pz, ld), *Y = space.zeros(nz, ps), *G = space.take(pz, pz);
    double *B = space.take(pw), *D = space.zeros(pw), *J = space.zeros(pw), *part_J = space.zeros(pw);
    const Lead lead(s);
    const int num_lead = Joints ? 0 : lead.size;  // few joints have none, see find_direct
    add_up<Joints>(s, shift, H);
    dense::gather(na, 1.0, s.Jw + na, pw + 1, D);
    dense::gather(na, 1.0, s.Js, ps + 1, J), dense::gather(na, part, s.Js, ps + 1, part_J);
    for (double* diagonal : {D, J, part_J}) dense::zero(diagonal, num_lead);
    const auto columns = [&](const Box& box) { return padded(box.columns); };
    for (int i = k.of_Hws.row; i < k.of_Hws.row + k.of_Hws.rows; ++i) {
        const int at = k.of_Hws.column, into = i < na ? i : i - na;
        dense::axpy(columns(k.of_Hws), i < na ? D[i] : 1.0, s.Hws + i * ps + at, Y + into * ps + at);
        for (int j = 0; j < num_lead && i < num_lead; ++j)
            dense::axpy(columns(k.of_Hws), lead.D[i * lead.ld + j], s.Hws + i * ps + at, Y + j * ps + at);
    }
    for (int i = 0; i < nz; ++i) {
        double *m = M + i * ld, *y = Y + i * ps, *g = G + i * pz;
        const double *a = H + i * pw, *z = H + (na + i) * pw, *S = s.S + i * pg;
        const double d = i < na ? D[i] : 0.0;
        for (int j = 0; j < pw; j += dense::width)  // row i of L'H
            dense::store(B + j, i < na ? d * dense::load(a + j) + dense::load(z + j) : dense::load(z + j));
        for (int j = 0; j < num_lead && i < num_lead; ++j) dense::axpy(pw, lead.D[j * lead.ld + i], H + j * pw, B);
        for (int j = 0; j < pg; j += dense::width) {
            dense::Vec v = na + i < nd ? dense::load(S + na * pg + j) : dense::Vec{};
            dense::store(m + j, i < na ? v + d * dense::load(S + j) : v);
        }
        for (int j = 0; j < num_lead && i < num_lead; ++j) dense::axpy(pg, lead.D[j * lead.ld + i], s.S + j * pg, m);
        for (int j = 0; j < pz; j += dense::width) {  // not from B: the processor waits for what crosses its vectors
            const dense::Vec beside = d * dense::load(a + na + j) + dense::load(z + na + j);
            dense::store(g + j, part * (beside + dense::load(D + j) * dense::load(B + j)));
        }
        if (i < num_lead)
            for (int j = 0; j < pz; j += dense::width)
                dense::store(g + j, part * (dense::load(B + na + j) + dense::load(D + j) * dense::load(B + j)));
        for (int j = 0; j < num_lead; ++j) {
            dense::axpy(lead.ld, part * B[j], lead.D + j * lead.ld, g);
            dense::axpy(lead.ld, B[j], lead.J + j * lead.ld, y);
        }
        dense::multiply_add(na, J, B, y);
        for (const auto& [row, column] : k.before) y[column] += s.Js[row * ps + column] * B[row];
    }
    dense::gemm_tn<Joints, false>(nz, ns, nz, G, pz, V, ps, M + pg, ld);
    for (int i = 0; i < nz; ++i) dense::axpy(ny, 1.0, Y + i * ps, M + i * ld + pg);
    for (int i = 0; i < na; ++i) {  // of J'(S | H J + 2 Hws): what the identity in J has, and the rest
        double* q = form.of_state + i * ld;
        dense::copy(s.S + i * pg, q, pg);
        dense::multiply_add(na, part_J, H + i * pw, q + pg);
        for (int j = 0; j < num_lead; ++j) dense::axpy(lead.ld, part * H[i * pw + j], lead.J + j * lead.ld, q + pg);
        for (const auto& [row, column] : k.before) q[pg + column] += part * s.Js[row * ps + column] * H[i * pw + row];
    }
    for (int i = k.of_Hws.row; i < std::min(na, k.of_Hws.row + k.of_Hws.rows); ++i) {
        const int at = k.of_Hws.column;
        dense::axpy(columns(k.of_Hws), 2.0 * part, s.Hws + i * ps + at, form.of_state + i * ld + pg + at);
    }
    const int num_kept = k.before.empty() ? num_lead : na;
    double* rows = space.take(num_kept, ld);
    dense::copy(form.of_state, rows, num_kept * ld);
    dense::zero(form.of_state, num_lead * ld);
    for (int i = 0; i < num_lead; ++i)
        for (int j = 0; j < num_lead; ++j)
            dense::axpy(ld, lead.J[j * lead.ld + i], rows + j * ld, form.of_state + i * ld);
    for (int i = num_lead; i < na; ++i)
        if (J[i] != 1.0) dense::scaled(ld, J[i], form.of_state + i * ld, form.of_state + i * ld);
    for (const auto& [row, column] : k.before)
        dense::axpy(ld, s.Js[row * ps + column], rows + row * ld, form.of_state + column * ld);
    if (k.couples_controls) {
        dense::gemm_tn<Joints>(ns, ld, nz, V, ps, M, ld, form.of_state, ld);
        dense::symmetrise(ns, form.of_state + pg, ld, s.Hss, ps);
        return form;
    }
    dense::gemm_tn<Joints, false>(nu, ld, nz, V + nd, ps, M, ld, form.of_controls, ld);
    for (int i = 0; i < nz; ++i) dense::axpy(pd, 1.0, Y + i * ps, M + i * ld + pg);
    dense::gemm_tn<Joints>(nd, pg + nd, nz, V, ps, M, ld, form.of_state, ld);
    add_hessian(s, form);
    return form;
}

// The same with followers a; by halves and their transposes.
Form DenseElimination::form_of_others(const Stage& s, double shift) {
    const FollowersOf f(s);
    const Kind& k = *s.kind;
    const std::vector<int>&a = f.of.a, &z = f.of.z;
    const int nd = problem_.ndx, nz = f.nz, pw = f.pw, pz = f.pz, ps = f.ps;
    const int pg = padded(problem_.ng);
    const Box& box = k.of_Hws;
    Space space(work_.data());
    const Form form = take_form(k, space, true);
    const int ld = form.ld;
    dense::zero(form.of_state, padded(f.ns) * ld);
    double *H = space.take(f.nw, pw), *B = space.take(nz, pw), *G = space.zeros(nz, pz), *M = space.take(pz, ld);
    double *Y = space.zeros(nz, ps), *X = space.take(nd, ld);  // the latter of a's rows alone
    add_up<0>(s, shift, H);
    const auto add_Hws = [&](int i, double by, double* to) {
        if (box.row <= i && i < box.row + box.rows)
            dense::axpy(padded(box.columns), by, s.Hws + i * ps + box.column, to + box.column);
    };
    for (int i = 0; i < nz; ++i) {  // B = L'H, and Y and L'S with it
        dense::copy(H + z[i] * pw, B + i * pw, pw);
        dense::zero(M + i * ld, pg);
        if (z[i] < nd) dense::copy(s.S + z[i] * pg, M + i * ld, pg);
        add_Hws(z[i], 1.0, Y + i * ps);
    }
    for (const Entry& e : f.of.D) {
        const double d = f.D(e);
        dense::axpy(pw, d, H + e.row * pw, B + e.column * pw);
        dense::axpy(pg, d, s.S + e.row * pg, M + e.column * ld);
        add_Hws(e.row, d, Y + e.column * ps);
    }
    for (int i = 0; i < nz; ++i)
        for (int j = 0; j < nz; ++j) G[i * pz + j] = 0.5 * B[i * pw + z[j]];
    for (const Entry& e : f.of.D) {
        const double d = 0.5 * f.D(e);
        for (int i = 0; i < nz; ++i) G[i * pz + e.column] += d * B[i * pw + e.row];
    }
    for (const int i : a) {
        dense::copy(s.S + i * pg, X + i * ld, pg), dense::zero(X + i * ld + pg, ps);
        add_Hws(i, 1.0, X + i * ld + pg);
    }
    for (const Entry& e : f.of.J) {
        const double by = f.J(e);
        for (int i = 0; i < nz && by != 0.0; ++i) Y[i * ps + e.column] += by * B[i * pw + e.row];
        for (std::size_t i = 0; i < a.size() && by != 0.0; ++i)
            X[a[i] * ld + pg + e.column] += 0.5 * by * H[a[i] * pw + e.row];
    }
    dense::gemm_tn<0, false>(nz, f.ns, nz, G, pz, f.V, ps, M + pg, ld);
    for (int i = 0; i < nz; ++i) dense::axpy(ps, 1.0, Y + i * ps, M + i * ld + pg);
    for (const Entry& e : f.of.J)
        if (const double by = f.J(e); by != 0.0) dense::axpy(ld, by, X + e.row * ld, form.of_state + e.column * ld);
    dense::gemm_tn(f.ns, ld, nz, f.V, ps, M, ld, form.of_state, ld);
    dense::symmetrise(f.ns, form.of_state + pg, ld, nullptr, 0);
    add_hessian(s, form);
    return form;
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
    const int px = padded(nd), pg = padded(ng);
    const double* c = rhs.c.data() + problem_.m_offset[n];
    Space space(vectors_.data());
    double *h = space.take(nw), *q = space.take(ns);
    for (int i = 0; i < s.kind->nc(); ++i) s.t0[i] = -c[i];
    step_.solve(n, s.t0);
    dense::copy(rhs.w.data() + problem_.m_offset[n], h, nw);
    dense::copy(rhs.s.data() + problem_.s_offset(n), q, ns);
    add_hessian_of(s, s.t0, h, q);
    for (int i = 0; i < nd; ++i) h[i] += s.p[i] + weights.shift * s.t0[i];
    dense::gemv_t(nd, nd, s.P, px, s.t0, h);  // which is symmetric
    add_response_transposed(s, h, q);
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
    const auto verify = [&](int n) { check->add_stage(n, rhs, out, weights.shift, data_[n].Hz); };
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

void DenseElimination::forward_motion(Increment& out) {
    Space space(work_.data());
    double *dw = space.take(problem_.kind().nw()), *ds = space.take(problem_.kind().ns());
    for (int n = 0; n < problem_.N; ++n) find_motion(n, dw, ds, out);
}

// Into dw and ds, and from there into the direction.
void DenseElimination::find_motion(int n, double* dw, double* ds, Increment& out) const {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    const int nd = problem_.ndx, nu = k.nu;
    const double* dx = out.dx.data() + problem_.dx_offset(n);
    double* du = out.du.data() + problem_.u_offset[n];
    dense::copy(s.k, du, nu);
    dense::gemv(nu, nd, s.K, padded(nd), dx, du);
    dense::gemv(nu, problem_.ng, s.Keta, padded(problem_.ng), out.deta.data(), du);
    dense::copy(dx, ds, nd);
    dense::copy(du, ds + nd, nu);
    dense::copy(s.t0, dw, k.nw());
    add_response(s, ds, dw);
    dense::copy(dw, out.dx.data() + problem_.dx_offset(n + 1), nd);
    dense::copy(dw + nd, out.dy.data() + problem_.y_offset[n], k.ny);
}

void DenseElimination::forward_stage(int n, const Residual& rhs, const Weights& weights, Increment& out) {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    const int nd = problem_.ndx, ng = problem_.ng, nw = k.nw(), ns = k.ns();
    const int px = padded(nd), pg = padded(ng);
    Space space(work_.data());
    double *dw = space.take(nw), *ds = space.take(ns), *of_s = s.Hz + nw;
    double* dm = out.dm.data() + problem_.m_offset[n];
    find_motion(n, dw, ds, out);
    dense::zero(s.Hz, nw + ns);
    step_.add_hessian(n, dw, ds, s.Hz, of_s);
    for (int i = 0; i < nd; ++i) s.Hz[i] += weights.shift * dw[i];
    const double* w = rhs.w.data() + problem_.m_offset[n];
    for (int i = 0; i < nw; ++i) dm[i] = w[i] + s.Hz[i];
    dense::gemv_t(nd, nd, s.P, px, dw, dm);
    for (int i = 0; i < nd; ++i) dm[i] += s.p[i];
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
