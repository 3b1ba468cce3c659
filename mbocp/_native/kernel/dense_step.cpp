#include "dense_step.hpp"

#include <algorithm>
#include <cmath>

#include "followers.hpp"
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

// With zeros as far as the row is padded; what is behind the given one can be read.
void copy_row(const double* from, double* to, int n) {
    for (int j = 0; j < n; j += dense::width) dense::store(to + j, dense::load_first(from + j, n - j));
}

// Jw = -1, as where a step's rows are F(x_before, u) - x.
bool is_minus_identity(const Stage& s) {
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (!s.kind->may_be_explicit) return false;
    for (int i = 0; i < nc; ++i)
        if (s.Jw[i * (pw + 1)] != -1.0) return false;
    return true;
}

// Sizes of the blocks of Jw, where they are in it, and their factors.
struct BlocksOf {
    explicit BlocksOf(const Stage& s)
        : kind(*s.kind), plain(kind.blocks.plain), upper(kind.blocks.upper), ne(upper - plain), ny(kind.nw() - upper),
          pw(padded(kind.nw())), pe(padded(ne)), py(padded(ny)), Jw(s.Jw), A(Jw + plain * pw), C(A + upper), E(s.LU),
          Y(E + ne * pe), pivot_E(s.pivot), pivot_Y(pivot_E + upper) {}

    const Kind& kind;
    const int plain, upper, ne, ny, pw, pe, py;
    const double *Jw, *A, *C;
    double *E, *Y;
    int *pivot_E, *pivot_Y;

    double D(int i) const { return Jw[i * (pw + 1)]; }
    double B(const Entry& entry) const { return Jw[entry.row * pw + entry.column]; }
};

// Whether the kind's direct rows, but for their lead, are a = D z + J s here, with D small enough to lose no digits
// without pivoting.
bool has_direct_rows(const Stage& s) {
    const int na = s.kind->num_direct, pw = padded(s.kind->nw());
    for (int i = s.kind->lead; i < na; ++i)
        if (s.Jw[i * (pw + 1)] != -1.0 || !(std::abs(s.Jw[i * (pw + 1) + na]) <= 1.0)) return false;
    return na > 0;
}

// y += A x and y += A'x where A has entries.
void add_product(const Box& box, const double* A, int lda, const double* x, double* y) {
    dense::gemv(box.rows, box.columns, A + box.row * lda + box.column, lda, x + box.column, y + box.row);
}
void add_transposed(const Box& box, const double* A, int lda, const double* x, double* y) {
    dense::gemv_t(box.rows, box.columns, A + box.row * lda + box.column, lda, x + box.row, y + box.column);
}

}  // namespace

void Lead::divide(double* c) const {
    double divided[dense::most_inverted] = {};
    dense::gemv(size, size, N, ld, c, divided);
    std::copy_n(divided, size, c);
}
void Lead::divide_transposed(double* w) const {
    double divided[dense::most_inverted] = {};
    dense::gemv_t(size, size, N, ld, w, divided);
    std::copy_n(divided, size, w);
}
void Lead::add_before(const double* ds, const double* z, double* a) const {
    dense::gemv(size, size, J, ld, ds, a);
    dense::gemv(size, size, D, ld, z, a, -1.0);
}
void Lead::add_transposed(const double* a, double* z, double* ds) const {
    dense::gemv_t(size, size, D, ld, a, z);
    dense::gemv_t(size, size, J, ld, a, ds);
}

std::unique_ptr<Step> make_step(const Problem& problem, Data& data) {
    if (problem.is_structured()) return std::make_unique<StructuredStep>(problem, data);
    return std::make_unique<DenseStep>(problem, data);
}

void DenseStep::add_places(Places& places) const {
    const Stage& s = data_[0];
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
    if (!k.followers.empty()) return FollowersOf(s).add_jacobian(dw, ds, c);
    const int na = k.num_direct, nz = k.nw() - na, pw = padded(k.nw()), ps = padded(k.ns()), lead = k.lead;
    if (lead) {
        dense::gemv(lead, lead, s.Jw, pw, dw, c), dense::gemv(lead, lead, s.Jw + na, pw, dw + na, c);
        dense::gemv(lead, lead, s.Js, ps, ds, c);
    }
    for (int i = lead; i < na; ++i) {
        const double* row = s.Jw + i * (pw + 1);
        c[i] += row[0] * dw[i] + row[na] * dw[na + i] + s.Js[i * (ps + 1)] * ds[i];
    }
    for (const auto& [i, j] : k.before) c[i] += s.Js[i * ps + j] * ds[j];
    dense::gemv(nz, k.nw(), s.Jw + na * pw, pw, dw, c + na);
    dense::gemv(nz, k.ns(), s.Js + na * ps, ps, ds, c + na);
}

void DenseStep::add_jacobian_transposed(int n, const double* dm, double* w, double* s) const {
    const Stage& at = data_[n];
    const Kind& k = *at.kind;
    if (!k.followers.empty()) return FollowersOf(at).add_jacobian_transposed(dm, w, s);
    const int na = k.num_direct, nz = k.nw() - na, pw = padded(k.nw()), ps = padded(k.ns()), lead = k.lead;
    if (w) {
        if (lead) dense::gemv_t(lead, lead, at.Jw, pw, dm, w), dense::gemv_t(lead, lead, at.Jw + na, pw, dm, w + na);
        for (int i = lead; i < na; ++i) {
            const double* row = at.Jw + i * (pw + 1);
            w[i] += row[0] * dm[i], w[na + i] += row[na] * dm[i];
        }
        dense::gemv_t(nz, k.nw(), at.Jw + na * pw, pw, dm + na, w);
    }
    if (!s) return;
    if (lead) dense::gemv_t(lead, lead, at.Js, ps, dm, s);
    for (int i = lead; i < na; ++i) s[i] += at.Js[i * (ps + 1)] * dm[i];
    for (const auto& [i, j] : k.before) s[j] += at.Js[i * ps + j] * dm[i];
    dense::gemv_t(nz, k.ns(), at.Js + na * ps, ps, dm + na, s);
}

void DenseStep::add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const {
    const Stage& at = data_[n];
    const Kind& k = *at.kind;
    const int nd = problem_.ndx, ps = padded(k.ns());
    add_hessian_of(at, dw, w, s);
    add_product(k.of_Hws, at.Hws, ps, ds, w);
    add_transposed(k.of_Hss_state, at.Hss, ps, ds, s);
    add_transposed(k.of_Hss_controls, at.Hss + nd * ps, ps, ds + nd, s);
}

void DenseStep::copy_state_jacobian(int n, double* F, int ld) const {
    const Stage& s = data_[n];
    for (int i = 0; i < problem_.ndx; ++i) dense::copy(s.Jw + i * padded(s.kind->nw()), F + i * ld, problem_.ndx);
}

double DenseStep::factor(int n, int thread) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    if (is_minus_identity(s)) return s.factors_of = StepFactors::none, 1.0;
    const double of_lead = has_direct_rows(s) ? factor_lead(s) : 0.0;
    if (of_lead > 0.0) return std::min(of_lead, factor_rest(s, thread));
    if (k.blocks.upper) return factor_blocks(s);
    if (const FollowersOf followers(s); followers.fit()) return s.factors_of = StepFactors::others, followers.factor();
    s.factors_of = StepFactors::whole;
    dense::copy(s.Jw, s.LU, k.nc() * padded(k.nw()));
    return dense::factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

// 0 where it is singular, or has a large D; 1 where there is none.
double DenseStep::factor_lead(Stage& s) const {
    const Lead lead(s);
    const int n = lead.size, ld = lead.ld, na = s.kind->num_direct, pw = padded(s.kind->nw());
    if (!n) return 1.0;
    double *N = s.lead, *of_w = N + n * ld, *of_s = of_w + n * ld, row[dense::most_inverted];
    const auto divided = [&](const double* given, int ldg, double* by) {  // by += N given
        for (int k = 0; k < n; ++k) {
            copy_row(given + k * ldg, row, n);
            for (int i = 0; i < n; ++i) dense::axpy(ld, N[i * ld + k], row, by + i * ld);
        }
    };
    for (int i = 0; i < n; ++i) copy_row(s.Jw + i * pw, N + i * ld, n);
    const double pivot = dense::factor(n, N, ld, s.pivot);
    dense::scaled(n * ld, -1.0, N, N), dense::zero(of_w, 2 * n * ld);
    divided(s.Jw + na, pw, of_w), divided(s.Js, padded(s.kind->ns()), of_s);
    return dense::largest(n * ld, of_w) <= 1.0 ? pivot : 0.0;
}

double DenseStep::factor_rest(Stage& s, int thread) const {
    const int nw = s.kind->nw(), pw = padded(nw), na = s.kind->num_direct, nz = nw - na, pz = padded(nz);
    const Lead lead(s);
    double* D = space(thread).take(na);
    dense::gather(na, 1.0, s.Jw + na, pw + 1, D);
    dense::zero(D, lead.size);
    s.factors_of = StepFactors::rest;
    for (int i = 0; i < nz; ++i) {
        const double* row = s.Jw + (na + i) * pw;
        copy_row(row + na, s.LU + i * pz, nz);
        dense::multiply_add(na, row, D, s.LU + i * pz);
        for (int k = 0; k < lead.size; ++k) dense::axpy(lead.ld, row[k], lead.D + k * lead.ld, s.LU + i * pz);
    }
    return dense::factor(nz, s.LU, pz, s.pivot);
}

double DenseStep::factor_blocks(Stage& s) const {
    const BlocksOf b(s);
    s.factors_of = StepFactors::blocks;
    double smallest = INFINITY, largest = 0.0;
    for (int i = 0; i < b.plain; ++i) {
        const double size = std::abs(b.D(i));
        if (!(size > 0.0) || !std::isfinite(size)) return 0.0;
        smallest = std::min(smallest, size), largest = std::max(largest, size);
    }
    for (int i = 0; i < b.ne; ++i) copy_row(b.A + i * b.pw + b.plain, b.E + i * b.pe, b.ne);
    for (int i = 0; i < b.ny; ++i) copy_row(b.Jw + (b.upper + i) * b.pw + b.upper, b.Y + i * b.py, b.ny);
    const double of_plain = b.plain ? smallest / largest : 1.0, of_E = dense::factor(b.ne, b.E, b.pe, b.pivot_E);
    return std::min({of_plain, of_E, dense::factor(b.ny, b.Y, b.py, b.pivot_Y)});
}

double DenseStep::factor_first(int n, const StageFunction& f) {
    Stage& s = data_[n];
    const Kind& k = *s.kind;
    s.factors_of = StepFactors::whole;
    dense::zero(s.LU, k.nc() * padded(k.nw()));
    for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
        if (k.to_first_jacobian[i].block == W) s.LU[k.to_first_jacobian[i].offset] = f.res[2][i];
    return dense::factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

void DenseStep::solve(int n, double* c) const {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (s.factors_of == StepFactors::whole) return dense::solve_vector(nc, s.LU, pw, s.pivot, c);
    if (s.factors_of == StepFactors::none) {
        for (int i = 0; i < nc; ++i) c[i] = -c[i];
        return;
    }
    if (s.factors_of == StepFactors::blocks) return solve_blocks(s, c);
    if (s.factors_of == StepFactors::others) return FollowersOf(s).solve(c);
    const int na = s.kind->num_direct, nz = nc - na;
    const Lead lead(s);
    double* z = c + na;
    if (lead.size) lead.divide(c);
    dense::gemv(nz, na, s.Jw + na * pw, pw, c, z);
    dense::solve_vector(nz, s.LU, padded(nz), s.pivot, z);
    for (int i = 0; i < lead.size; ++i) c[i] = -c[i];
    if (lead.size) dense::gemv(lead.size, lead.size, lead.D, lead.ld, z, c);
    for (int i = lead.size; i < na; ++i) c[i] = s.Jw[i * (pw + 1) + na] * z[i] - c[i];
}

void DenseStep::solve_transposed(int n, double* w) const {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (s.factors_of == StepFactors::whole) return dense::solve_transposed(nc, s.LU, pw, s.pivot, w);
    if (s.factors_of == StepFactors::blocks) return solve_blocks_transposed(s, w);
    if (s.factors_of == StepFactors::others) return FollowersOf(s).solve_transposed(w);
    for (int i = 0; i < nc && s.factors_of == StepFactors::none; ++i) w[i] = -w[i];
    if (s.factors_of == StepFactors::none) return;
    const int na = s.kind->num_direct, nz = nc - na;
    const Lead lead(s);
    double* z = w + na;
    if (lead.size) dense::gemv_t(lead.size, lead.size, lead.D, lead.ld, w, z);
    for (int i = lead.size; i < na; ++i) z[i] += s.Jw[i * (pw + 1) + na] * w[i];
    for (int i = 0; i < na; ++i) w[i] = -w[i];
    dense::solve_transposed(nz, s.LU, padded(nz), s.pivot, z);
    dense::gemv_t(nz, na, s.Jw + na * pw, pw, z, w);
    if (lead.size) lead.divide_transposed(w);
}

void DenseStep::solve_blocks(const Stage& s, double* c) const {
    const BlocksOf b(s);
    double *of_E = c + b.plain, *of_Y = c + b.upper;
    dense::solve_vector(b.ny, b.Y, b.py, b.pivot_Y, of_Y);
    for (const Entry& entry : b.kind.beyond) c[entry.row] -= b.B(entry) * c[entry.column];
    for (int i = 0; i < b.plain; ++i) c[i] /= b.D(i);
    dense::gemv(b.ne, b.plain, b.A, b.pw, c, of_E, -1.0);
    dense::gemv(b.ne, b.ny, b.C, b.pw, of_Y, of_E, -1.0);
    dense::solve_vector(b.ne, b.E, b.pe, b.pivot_E, of_E);
}

void DenseStep::solve_blocks_transposed(const Stage& s, double* w) const {
    const BlocksOf b(s);
    double *of_E = w + b.plain, *of_Y = w + b.upper;
    dense::solve_transposed(b.ne, b.E, b.pe, b.pivot_E, of_E);
    dense::gemv_t(b.ne, b.plain, b.A, b.pw, of_E, w, -1.0);
    for (int i = 0; i < b.plain; ++i) w[i] /= b.D(i);
    for (const Entry& entry : b.kind.beyond) w[entry.column] -= b.B(entry) * w[entry.row];
    dense::gemv_t(b.ne, b.ny, b.C, b.pw, of_E, of_Y, -1.0);
    dense::solve_transposed(b.ny, b.Y, b.py, b.pivot_Y, of_Y);
}

double DenseStep::prepare_response(int n, int thread) {
    const Stage& s = data_[n];
    const int nc = s.kind->nc(), ps = padded(s.kind->ns());
    const double pivot = factor(n, thread);
    if (s.factors_of == StepFactors::rest) {
        if (pivot > 0.0) respond_rest(s, thread);
        return pivot;
    }
    if (s.factors_of == StepFactors::others) {
        if (pivot > 0.0) FollowersOf(s).respond();
        return pivot;
    }
    dense::scaled(nc * ps, s.factors_of == StepFactors::none ? 1.0 : -1.0, s.Js, s.T);
    if (pivot == 0.0 || s.factors_of == StepFactors::none) return pivot;
    if (s.factors_of == StepFactors::blocks) return respond_blocks(s), pivot;
    dense::solve(nc, s.LU, padded(s.kind->nw()), s.pivot, s.T, ps, ps);
    return pivot;
}

// T of z alone: with a = D z + J s the other rows are (E + A D) z + (B + A J) s = 0.
void DenseStep::respond_rest(const Stage& s, int thread) const {
    const Kind& k = *s.kind;
    const int nw = k.nw(), na = k.num_direct, nz = nw - na, pw = padded(nw), ps = padded(k.ns());
    const Lead lead(s);
    double *V = s.T + na * ps, *minus_J = space(thread).take(na);
    dense::gather(na, -1.0, s.Js, ps + 1, minus_J);
    dense::zero(minus_J, lead.size);
    for (int i = 0; i < nz; ++i) {
        const double* A = s.Jw + (na + i) * pw;
        double* v = V + i * ps;
        dense::scaled(ps, -1.0, s.Js + (na + i) * ps, v);
        dense::multiply_add(na, A, minus_J, v);
        for (int j = 0; j < lead.size; ++j) dense::axpy(lead.ld, -A[j], lead.J + j * lead.ld, v);
        for (const auto& [row, column] : k.before) v[column] -= A[row] * s.Js[row * ps + column];
    }
    dense::solve(nz, s.LU, padded(nz), s.pivot, V, ps, ps);
}

void add_hessian_of(const Stage& at, const double* dw, double* w, double* s) {
    const Kind& k = *at.kind;
    for (const Box& box : {k.of_Hww_state, k.of_Hww_rest})  // Hww is symmetric, as Hss is
        add_transposed(box, at.Hww, padded(k.nw()), dw, w);
    add_transposed(k.of_Hws, at.Hws, padded(k.ns()), dw, s);
}

void complete_response(const Stage& s) {
    if (s.factors_of == StepFactors::others) return FollowersOf(s).complete();
    if (s.factors_of != StepFactors::rest) return;
    const int na = s.kind->num_direct, pw = padded(s.kind->nw()), ps = padded(s.kind->ns());
    const Lead lead(s);
    for (int i = 0; i < lead.size; ++i) {
        dense::zero(s.T + i * ps, ps);
        dense::copy(lead.J + i * lead.ld, s.T + i * ps, lead.size);
        for (int k = 0; k < lead.size; ++k) dense::axpy(ps, lead.D[i * lead.ld + k], s.T + (na + k) * ps, s.T + i * ps);
    }
    for (int i = lead.size; i < na; ++i) {
        dense::copy(s.Js + i * ps, s.T + i * ps, ps);
        dense::axpy(ps, s.Jw[i * (pw + 1) + na], s.T + (na + i) * ps, s.T + i * ps);
    }
}

void add_response(const Stage& s, const double* ds, double* dw) {
    const Kind& k = *s.kind;
    const int nw = k.nw(), ns = k.ns(), pw = padded(nw), ps = padded(ns);
    if (s.factors_of == StepFactors::others) return FollowersOf(s).add_response(ds, dw);
    if (s.factors_of != StepFactors::rest) return dense::gemv(nw, ns, s.T, ps, ds, dw);
    const int na = k.num_direct, nz = nw - na;
    const Lead lead(s);
    double* z = dw + na;
    if (lead.size) lead.add_before(ds, z, dw);
    for (int i = lead.size; i < na; ++i) dw[i] += s.Js[i * (ps + 1)] * ds[i] - s.Jw[i * (pw + 1) + na] * z[i];
    for (const auto& [row, column] : k.before) dw[row] += s.Js[row * ps + column] * ds[column];
    dense::gemv(nz, ns, s.T + na * ps, ps, ds, z);
    if (lead.size) dense::gemv(lead.size, lead.size, lead.D, lead.ld, z, dw);
    for (int i = lead.size; i < na; ++i) dw[i] += s.Jw[i * (pw + 1) + na] * z[i];
}

void add_response_transposed(const Stage& s, double* dw, double* ds) {
    const Kind& k = *s.kind;
    const int nw = k.nw(), ns = k.ns(), pw = padded(nw), ps = padded(ns);
    if (s.factors_of == StepFactors::others) return FollowersOf(s).add_response_transposed(dw, ds);
    if (s.factors_of != StepFactors::rest) return dense::gemv_t(nw, ns, s.T, ps, dw, ds);
    const int na = k.num_direct, nz = nw - na;
    const Lead lead(s);
    double* z = dw + na;
    if (lead.size) lead.add_transposed(dw, z, ds);
    for (int i = lead.size; i < na; ++i) z[i] += s.Jw[i * (pw + 1) + na] * dw[i], ds[i] += s.Js[i * (ps + 1)] * dw[i];
    for (const auto& [row, column] : k.before) ds[column] += s.Js[row * ps + column] * dw[row];
    dense::gemv_t(nz, ns, s.T + na * ps, ps, z, ds);
}

// T from -Js, which it has.
void DenseStep::respond_blocks(const Stage& s) const {
    const BlocksOf b(s);
    const int ps = padded(s.kind->ns());
    double *of_E = s.T + b.plain * ps, *of_Y = s.T + b.upper * ps;
    dense::solve(b.ny, b.Y, b.py, b.pivot_Y, of_Y, ps, ps);
    for (const Entry& entry : b.kind.beyond)
        dense::axpy(ps, -b.B(entry), s.T + entry.column * ps, s.T + entry.row * ps);
    for (int i = 0; i < b.plain; ++i) dense::scaled(ps, 1.0 / b.D(i), s.T + i * ps, s.T + i * ps);
    dense::gemm_nn(b.ne, ps, b.plain, b.A, b.pw, s.T, ps, of_E, ps, -1.0);
    dense::gemm_nn(b.ne, ps, b.ny, b.C, b.pw, of_Y, ps, of_E, ps, -1.0);
    dense::solve(b.ne, b.E, b.pe, b.pivot_E, of_E, ps, ps);
}

void DenseStep::respond(int n, const double* ds, double* dw) const {
    dense::zero(dw, data_[n].kind->nw());
    add_response(data_[n], ds, dw);
}

}  // namespace mbocp
