#include "kkt_check.hpp"

#include <algorithm>
#include <cmath>

namespace mbocp {
using dense::padded;

KktCheck::KktCheck(const Problem& problem, const Data& data, const Step& step, const Barrier& barrier)
    : left(problem), of_start(problem.ndx, 0.0), problem_(problem), data_(data), step_(step), barrier_(barrier) {
    work_.allocate(2 * static_cast<std::size_t>(problem.kind().nw() + problem.kind().ns()) + 32);
}

void KktCheck::add_stage(int n, const Residual& rhs, const Increment& d, double shift, const double* Hz) {
    const Kind& k = problem_.kind();
    const int nd = problem_.ndx, nw = k.nw(), ns = k.ns(), nc = k.nc(), nu = k.nu;
    const std::size_t at_m = problem_.m_offset[n], at_s = problem_.s_offset(n);
    Space space(work_.data());
    double *ds = space.take(ns), *dw = space.take(nw), *Hw = space.zeros(nw), *Hs = space.zeros(ns);
    dense::copy(d.dx.data() + problem_.dx_offset(n), ds, nd);
    dense::copy(d.du.data() + problem_.u_offset[n], ds + nd, nu);
    dense::copy(d.dx.data() + problem_.dx_offset(n + 1), dw, nd);
    dense::copy(d.dy.data() + problem_.y_offset[n], dw + nd, k.ny);
    double* c = left.c.data() + at_m;
    dense::copy(rhs.c.data() + at_m, c, nc);
    step_.add_jacobian(n, dw, ds, c);
    if (Hz) {
        dense::copy(Hz, Hw, nw), dense::copy(Hz + nw, Hs, ns);
    } else {
        step_.add_hessian(n, dw, ds, Hw, Hs);
        for (int i = 0; i < nd; ++i) Hw[i] += shift * dw[i];
    }
    if (!barrier_.empty()) barrier_.add_products(n, dw, ds + nd, Hw, Hs + nd);
    curvature += dense::dot(nw, dw, Hw) + dense::dot(ns, ds, Hs);
    double *w = left.w.data() + at_m, *r = left.s.data() + at_s;
    for (int i = 0; i < nw; ++i) w[i] = rhs.w[at_m + i] + Hw[i];
    for (int i = 0; i < ns; ++i) r[i] = rhs.s[at_s + i] + Hs[i];
    step_.add_jacobian_transposed(n, d.dm.data() + at_m, w, r);
    if (n > 0) {  // both contributions to x_{n-1} belong to one row
        double* before = left.w.data() + problem_.m_offset[n - 1];
        for (int i = 0; i < nd; ++i) before[i] += r[i];
        largest = std::max(largest, dense::largest(nd, before));
    } else {
        dense::copy(r, of_start.data(), nd);
    }
    std::fill(r, r + nd, 0.0);
    const double here = std::max(dense::largest(nw - nd, w + nd), dense::largest(nu, r + nd));
    largest = std::max({largest, dense::largest(nc, c), here});
}

void KktCheck::add_end(const Residual& rhs, const Increment& d) {
    const int nd = problem_.ndx, ng = problem_.ng, px = padded(nd), pg = padded(ng);
    const End& end = data_.end;
    const double* dx = d.dx.data() + problem_.dx_offset(problem_.N);
    double* last = left.w.data() + problem_.m_offset[problem_.N - 1];
    double* Hx = Space(work_.data()).zeros(nd);
    dense::gemv(nd, nd, end.H.data(), px, dx, Hx);
    for (int i = 0; i < nd; ++i) curvature += dx[i] * Hx[i], last[i] += Hx[i] + rhs.x_terminal[i];
    dense::gemv(nd, ng, end.S.data(), pg, d.deta.data(), last);
    std::fill(left.x_terminal.begin(), left.x_terminal.end(), 0.0);
    left.g = rhs.g;
    dense::gemv_t(nd, ng, end.S.data(), pg, dx, left.g.data());
    for (int i = 0; i < nd; ++i) largest = std::max(largest, std::abs(last[i]));
    for (const double v : left.g) largest = std::max(largest, std::abs(v));
}

}  // namespace mbocp
