// A stage's derivatives and its linearised step, dense or with a structure.
#include "programme.hpp"

namespace mbocp {
using dense::padded;

// c += Jw dw + Js ds
void Programme::add_jacobian(int n, const double* dw, const double* ds, double* c) const {
    const Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure) {
        k.structure->Jw.times(s.J, dw, c);
        k.structure->Js.times(s.J, ds, c);
    } else {
        dense::gemv(k.nc(), k.nw(), s.Jw, padded(k.nw()), dw, c);
        dense::gemv(k.nc(), k.ns(), s.Js, padded(k.ns()), ds, c);
    }
}

// w += Jw' dm, s += Js' dm, each where it is not null
void Programme::add_jacobian_transposed(int n, const double* dm, double* w, double* s) const {
    const Stage& at = stages_[n];
    const Kind& k = *at.kind;
    if (k.structure) {
        if (w) k.structure->Jw.transposed_times(at.J, dm, w);
        if (s) k.structure->Js.transposed_times(at.J, dm, s);
    } else {
        if (w) dense::gemv_t(k.nc(), k.nw(), at.Jw, padded(k.nw()), dm, w);
        if (s) dense::gemv_t(k.nc(), k.ns(), at.Js, padded(k.ns()), dm, s);
    }
}

// w += Hww dw + Hws ds, s += Hss ds + Hws' dw
void Programme::add_hessian(int n, const double* dw, const double* ds, double* w, double* s) {
    const Stage& at = stages_[n];
    const Kind& k = *at.kind;
    const int nw = k.nw(), ns = k.ns(), pw = padded(nw), ps = padded(ns);
    if (k.structure) {
        double *z = both_.data(), *Hz = z + nw + ns;
        dense::copy(dw, z, nw), dense::copy(ds, z + nw, ns);
        dense::zero(Hz, nw + ns);
        k.hessian.times(at.H, z, Hz);
        for (int i = 0; i < nw; ++i) w[i] += Hz[i];
        for (int i = 0; i < ns; ++i) s[i] += Hz[nw + i];
    } else {
        dense::gemv(nw, nw, at.Hww, pw, dw, w);
        dense::gemv(nw, ns, at.Hws, ps, ds, w);
        dense::gemv(ns, ns, at.Hss, ps, ds, s);
        dense::gemv_t(nw, ns, at.Hws, ps, dw, s);
    }
}

bool Programme::is_minus_identity(int n) const {
    const Stage& s = stages_[n];
    const int nc = s.kind->nc(), pw = padded(s.kind->nw());
    if (!s.kind->may_be_explicit) return false;
    for (int i = 0; i < nc; ++i)
        if (s.Jw[i * (pw + 1)] != -1.0) return false;
    return true;
}

// Factorises Jw; returns the relative size of the smallest pivot.
double Programme::factor_step(int n) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure) return k.structure->factor(s.J, s.step, space_.data());
    if ((s.is_explicit = is_minus_identity(n))) return 1.0;
    dense::copy(s.Jw, s.LU, k.nc() * padded(k.nw()));
    return dense::lu_factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

// The same for a step as the function `jacobian` has just returned it; zero where it cannot be solved.
double Programme::factor_step_of(int n, const StageFunction& f) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure) {
        store_first_jacobian(n, f);
        return k.structure->factor(s.J, s.step, space_.data());
    }
    s.is_explicit = false;
    dense::zero(s.LU, k.nc() * padded(k.nw()));
    for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
        if (k.to_first_jacobian[i].block == JW) s.LU[k.to_first_jacobian[i].offset] = f.res[2][i];
    return dense::lu_factor(k.nc(), s.LU, padded(k.nw()), s.pivot);
}

// Jacobian from the function `jacobian`.
void Programme::store_first_jacobian(int n, const StageFunction& f) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure) {
        dense::zero(s.J, k.complete->outputs[2].nnz());
        for (std::size_t i = 0; i < k.first_place.size(); ++i) s.J[k.first_place[i]] = f.res[2][i];
        return;
    }
    double* blocks[] = {s.Jw, s.Js};
    for (std::size_t i = 0; i < k.to_first_jacobian.size(); ++i)
        blocks[k.to_first_jacobian[i].block][k.to_first_jacobian[i].offset] = f.res[2][i];
}

// F <- Jw's rows of the dynamics in the state, with leading dimension ld.
void Programme::copy_state_jacobian(int n, double* F, int ld) const {
    const Stage& s = stages_[n];
    if (!s.kind->structure) {
        for (int i = 0; i < ndx_; ++i) dense::copy(s.Jw + i * padded(s.kind->nw()), F + i * ld, ndx_);
        return;
    }
    const SparseRows& Jw = s.kind->structure->Jw;
    dense::zero(F, ndx_ * ld);
    for (int i = 0; i < ndx_; ++i)
        for (int k = Jw.start[i]; k < Jw.start[i + 1]; ++k)
            if (Jw.column[k] < ndx_) F[i * ld + Jw.column[k]] = s.J[Jw.index[k]];
}

// c <- Jw^{-1} c after `factor_step`.
void Programme::solve_step(int n, double* c) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure)
        k.structure->solve_vector(s.J, s.step, c, space_.data());
    else if (s.is_explicit)
        for (int i = 0; i < k.nc(); ++i) c[i] = -c[i];
    else
        dense::lu_solve_vector(k.nc(), s.LU, padded(k.nw()), s.pivot, c);
}

// C <- -Jw^{-1} C likewise, without a structure; all of ldc columns.
void Programme::solve_steps(int n, double* C, int ldc) {
    Stage& s = stages_[n];
    const int nc = s.kind->nc();
    if (s.is_explicit) return;
    for (int i = 0; i < nc * ldc; ++i) C[i] = -C[i];
    dense::lu_solve(nc, s.LU, padded(s.kind->nw()), s.pivot, C, ldc, ldc);
}

// w <- Jw^{-T} w likewise.
void Programme::solve_step_transposed(int n, double* w) {
    Stage& s = stages_[n];
    const Kind& k = *s.kind;
    if (k.structure)
        k.structure->solve_transposed(s.J, s.step, w, space_.data());
    else if (s.is_explicit)
        for (int i = 0; i < k.nc(); ++i) w[i] = -w[i];
    else
        dense::lu_solve_transposed(k.nc(), s.LU, padded(k.nw()), s.pivot, w);
}

// k <- Quu^{-1} k
void Programme::solve_controls(const Stage& s, double* k) const {
    const int nu = s.kind->nu, pu = padded(nu);
    if (s.definite)
        dense::cholesky_solve_vector(nu, s.Quu, pu, k);
    else
        dense::lu_solve_vector(nu, s.Quu, pu, s.control_pivot, k);
}

}  // namespace mbocp
