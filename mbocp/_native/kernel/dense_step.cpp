#include "dense_step.hpp"

#include <cmath>

#include "structured_step.hpp"

namespace mbocp {
using dense::padded;

namespace {

void scatter(const Targets& targets, const double* values, double* const* blocks) {
    for (std::size_t i = 0; i < targets.size(); ++i) {
        const Target& t = targets[i];
        blocks[t.block][t.offset] = values[i];
        if (t.mirror >= 0) blocks[t.block][t.mirror] = values[i];
    }
}

// Jw = -1, as where a step's rows are F(x_before, u) - x.
bool is_minus_identity(const Stage& s) {
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (!s.kind->may_be_explicit) return false;
    for (int i = 0; i < nc; ++i)
        if (s.Jw[i * (pw + 1)] != -1.0) return false;
    return true;
}

// Whether the kind's direct rows are a = D z + J s here, with D small enough to lose no digits without pivoting.
bool has_direct_rows(const Stage& s) {
    const int na = s.kind->num_direct, pw = padded(s.kind->nw());
    for (int i = 0; i < na; ++i)
        if (s.Jw[i * (pw + 1)] != -1.0 || !(std::abs(s.Jw[i * (pw + 1) + na]) <= 1.0)) return false;
    return na > 0;
}

}  // namespace

std::unique_ptr<Step> make_step(const Problem& problem, Data& data) {
    if (problem.is_structured()) return std::make_unique<StructuredStep>(problem, data);
    return std::make_unique<DenseStep>(problem, data);
}

void DenseStep::add_places(int n, Places& places) const {
    const Stage& s = data_[n];
    const std::vector<int>& first = s.kind->complete->first;
    double *const jacobian[] = {s.Jw, s.Js}, *const hessian[] = {s.Hww, s.Hws, s.Hss};
    const auto add = [&](const Targets& targets, double* const* blocks, int from) {
        for (const Target& t : targets) {
            const int block = static_cast<int>(blocks[t.block] - s.begin());
            places.push_back({from, block + t.offset});
            if (t.mirror >= 0) places.push_back({from, block + t.mirror});
            ++from;
        }
    };
    add(s.kind->to_jacobian, jacobian, first[2]);
    add(s.kind->to_hessian, hessian, first[4]);
}

void DenseStep::store_first(int n, const StageFunction& f) {
    const Stage& s = data_[n];
    double* const jacobian[] = {s.Jw, s.Js};
    scatter(s.kind->to_first_jacobian, f.res[2], jacobian);
}

void DenseStep::add_jacobian(int n, const double* dw, const double* ds, double* c) const {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    dense::gemv(k.nc(), k.nw(), s.Jw, padded(k.nw()), dw, c);
    dense::gemv(k.nc(), k.ns(), s.Js, padded(k.ns()), ds, c);
}

void DenseStep::add_jacobian_transposed(int n, const double* dm, double* w, double* s) const {
    const Stage& at = data_[n];
    const Kind& k = *at.kind;
    if (w) dense::gemv_t(k.nc(), k.nw(), at.Jw, padded(k.nw()), dm, w);
    if (s) dense::gemv_t(k.nc(), k.ns(), at.Js, padded(k.ns()), dm, s);
}

void DenseStep::add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const {
    const Stage& at = data_[n];
    const int nw = at.kind->nw(), ns = at.kind->ns(), pw = padded(nw), ps = padded(ns);
    dense::gemv(nw, nw, at.Hww, pw, dw, w);
    dense::gemv(nw, ns, at.Hws, ps, ds, w);
    dense::gemv(ns, ns, at.Hss, ps, ds, s);
    dense::gemv_t(nw, ns, at.Hws, ps, dw, s);
}

void DenseStep::copy_state_jacobian(int n, double* F, int ld) const {
    const Stage& s = data_[n];
    for (int i = 0; i < problem_.ndx; ++i) dense::copy(s.Jw + i * padded(s.kind->nw()), F + i * ld, problem_.ndx);
}

double DenseStep::factor(int n, int thread) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    if (is_minus_identity(s)) return s.factors_of = StepFactors::none, 1.0;
    if (has_direct_rows(s)) return factor_rest(s, thread);
    s.factors_of = StepFactors::whole;
    dense::copy(s.Jw, s.LU, k.nc() * padded(k.nw()));
    return dense::lu_factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

double DenseStep::factor_rest(Stage& s, int thread) const {
    const int nw = s.kind->nw(), pw = padded(nw), na = s.kind->num_direct, nz = nw - na, pz = padded(nz);
    double* D = space(thread).zeros(na);
    for (int i = 0; i < na; ++i) D[i] = s.Jw[i * (pw + 1) + na];
    s.factors_of = StepFactors::rest;
    for (int i = 0; i < nz; ++i) {
        const double* row = s.Jw + (na + i) * pw;
        dense::copy(row + na, s.LU + i * pz, nz);
        dense::multiply_add(na, row, D, s.LU + i * pz);
    }
    return dense::lu_factor(nz, s.LU, pz, s.pivot);
}

double DenseStep::factor_first(int n, const StageFunction& f) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    s.factors_of = StepFactors::whole;
    dense::zero(s.LU, k.nc() * padded(k.nw()));
    for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
        if (k.to_first_jacobian[i].block == W) s.LU[k.to_first_jacobian[i].offset] = f.res[2][i];
    return dense::lu_factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

void DenseStep::solve(int n, double* c) const {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (s.factors_of == StepFactors::whole) return dense::lu_solve_vector(nc, s.LU, pw, s.pivot, c);
    if (s.factors_of == StepFactors::none) {
        for (int i = 0; i < nc; ++i) c[i] = -c[i];
        return;
    }
    const int na = s.kind->num_direct, nz = nc - na;
    double* z = c + na;
    dense::gemv(nz, na, s.Jw + na * pw, pw, c, z);
    dense::lu_solve_vector(nz, s.LU, padded(nz), s.pivot, z);
    for (int i = 0; i < na; ++i) c[i] = s.Jw[i * (pw + 1) + na] * z[i] - c[i];
}

void DenseStep::solve_transposed(int n, double* w) const {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (s.factors_of == StepFactors::whole) return dense::lu_solve_transposed(nc, s.LU, pw, s.pivot, w);
    for (int i = 0; i < nc && s.factors_of == StepFactors::none; ++i) w[i] = -w[i];
    if (s.factors_of == StepFactors::none) return;
    const int na = s.kind->num_direct, nz = nc - na;
    double* z = w + na;
    for (int i = 0; i < na; ++i) z[i] += s.Jw[i * (pw + 1) + na] * w[i], w[i] = -w[i];
    dense::lu_solve_transposed(nz, s.LU, padded(nz), s.pivot, z);
    dense::gemv_t(nz, na, s.Jw + na * pw, pw, z, w);
}

double DenseStep::prepare_response(int n, int thread) {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), ps = padded(s.kind->ns());
    const double pivot = factor(n, thread);
    if (s.factors_of == StepFactors::rest) {
        if (pivot > 0.0) respond_rest(s, thread);
        return pivot;
    }
    dense::copy(s.Js, s.T, nc * ps);
    if (pivot == 0.0 || s.factors_of == StepFactors::none) return pivot;
    for (int i = 0; i < nc * ps; ++i) s.T[i] = -s.T[i];
    dense::lu_solve(nc, s.LU, padded(s.kind->nw()), s.pivot, s.T, ps, ps);
    return pivot;
}

// T, of z first: with a = D z + J s the other rows are (E + A D) z + (B + A J) s = 0.
void DenseStep::respond_rest(const Stage& s, int thread) const {
    const Kind& k = *s.kind;
    const int nw = k.nw(), na = k.num_direct, nz = nw - na, pw = padded(nw), ps = padded(k.ns());
    double *V = s.T + na * ps, *minus_J = space(thread).zeros(na);
    for (int i = 0; i < na; ++i) minus_J[i] = -s.Js[i * (ps + 1)];
    for (int i = 0; i < nz; ++i) {
        const double* A = s.Jw + (na + i) * pw;
        double* v = V + i * ps;
        dense::scaled(ps, -1.0, s.Js + (na + i) * ps, v);
        dense::multiply_add(na, A, minus_J, v);
        for (const auto& [row, column] : k.before) v[column] -= A[row] * s.Js[row * ps + column];
    }
    dense::lu_solve(nz, s.LU, padded(nz), s.pivot, V, ps, ps);
    for (int i = 0; i < na; ++i) {
        dense::copy(s.Js + i * ps, s.T + i * ps, ps);
        dense::axpy(ps, s.Jw[i * (pw + 1) + na], V + i * ps, s.T + i * ps);
    }
}

void DenseStep::respond(int n, const double* ds, double* dw) const {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    dense::zero(dw, k.nw());
    dense::gemv(k.nw(), k.ns(), s.T, padded(k.ns()), ds, dw);
}

}  // namespace mbocp
