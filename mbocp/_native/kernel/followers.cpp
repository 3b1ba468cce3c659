#include "followers.hpp"

#include <cmath>

namespace mbocp {
using dense::padded;

std::size_t size_of_followers(const Kind& k) {
    const std::size_t nz = k.followers.z.size();
    const int pz = padded(static_cast<int>(nz)), pk = padded(static_cast<int>(k.followers.known.size()));
    return k.followers.empty() ? 0 : nz * (pk + padded(k.ns())) + pz + pk;
}

FollowersOf::FollowersOf(const Stage& s)
    : of(s.kind->followers), nw(s.kind->nw()), ns(s.kind->ns()), nz(static_cast<int>(of.z.size())),
      nk(static_cast<int>(of.known.size())), pw(padded(nw)), ps(padded(ns)), pz(padded(nz)), pk(padded(nk)), Jw(s.Jw),
      Js(s.Js), E(s.LU), A(s.V + nz * ps), V(s.V), T(s.T), pivot(s.pivot), of_z_(A + nz * pk), known_(of_z_ + pz) {}

bool FollowersOf::fit() const {
    for (const int i : of.a)
        if (Jw[i * (pw + 1)] != -1.0) return false;
    for (const Entry& e : of.D)
        if (of.place[e.row] >= 0 && !(std::abs(D(e)) <= 1.0)) return false;
    return !of.empty();
}

double FollowersOf::factor() const {
    dense::zero(E, nz * pz);
    for (int k = 0; k < nz; ++k) {
        const double* row = Jw + of.z[k] * pw;
        for (int j = 0; j < nz; ++j) E[k * pz + j] = row[of.z[j]];
        for (int j = 0; j < nk; ++j) A[k * pk + j] = row[of.known[j]];
    }
    for (const Entry& e : of.D) {
        const int place = of.place[e.row];
        const double d = D(e);
        for (int k = 0; k < nz && place >= 0; ++k) E[k * pz + e.column] += d * A[k * pk + place];
    }
    return dense::factor(nz, E, pz, pivot);
}

void FollowersOf::respond() const {
    for (int k = 0; k < nz; ++k) dense::scaled(ps, -1.0, Js + of.z[k] * ps, V + k * ps);
    for (const Entry& e : of.J) {
        const int place = of.place[e.row];
        const double by = J(e);
        for (int k = 0; k < nz && place >= 0; ++k) V[k * ps + e.column] -= by * A[k * pk + place];
    }
    dense::solve(nz, E, pz, pivot, V, ps, ps);
}

void FollowersOf::complete() const {
    for (int k = 0; k < nz; ++k) dense::copy(V + k * ps, T + of.z[k] * ps, ps);
    for (const int i : of.a) dense::zero(T + i * ps, ps);
    for (const Entry& e : of.D) dense::axpy(ps, D(e), V + e.column * ps, T + e.row * ps);
    for (const Entry& e : of.J) T[e.row * ps + e.column] += J(e);
}

void FollowersOf::add_jacobian(const double* dw, const double* ds, double* c) const {
    for (const int i : of.a) c[i] += Jw[i * (pw + 1)] * dw[i];
    for (const Entry& e : of.D) c[e.row] += D(e) * dw[of.z[e.column]];
    for (const Entry& e : of.J) c[e.row] += J(e) * ds[e.column];
    for (const auto& [first, count] : of.runs) {
        dense::gemv(count, nw, Jw + first * pw, pw, dw, c + first);
        dense::gemv(count, ns, Js + first * ps, ps, ds, c + first);
    }
}

void FollowersOf::add_jacobian_transposed(const double* dm, double* w, double* s) const {
    for (const int i : of.a)
        if (w) w[i] += Jw[i * (pw + 1)] * dm[i];
    for (const Entry& e : of.D)
        if (w) w[of.z[e.column]] += D(e) * dm[e.row];
    for (const Entry& e : of.J)
        if (s) s[e.column] += J(e) * dm[e.row];
    for (const auto& [first, count] : of.runs) {
        if (w) dense::gemv_t(count, nw, Jw + first * pw, pw, dm + first, w);
        if (s) dense::gemv_t(count, ns, Js + first * ps, ps, dm + first, s);
    }
}

void FollowersOf::solve(double* c) const {
    for (int k = 0; k < nz; ++k) of_z_[k] = c[of.z[k]];
    for (int j = 0; j < nk; ++j) known_[j] = c[of.known[j]];
    dense::gemv(nz, nk, A, pk, known_, of_z_);
    dense::solve_vector(nz, E, pz, pivot, of_z_);
    for (const int i : of.a) c[i] = -c[i];
    for (const Entry& e : of.D) c[e.row] += D(e) * of_z_[e.column];
    for (int k = 0; k < nz; ++k) c[of.z[k]] = of_z_[k];
}

void FollowersOf::solve_transposed(double* w) const {
    for (int k = 0; k < nz; ++k) of_z_[k] = w[of.z[k]];
    for (const Entry& e : of.D) of_z_[e.column] += D(e) * w[e.row];
    dense::solve_transposed(nz, E, pz, pivot, of_z_);
    dense::zero(known_, pk);
    dense::gemv_t(nz, nk, A, pk, of_z_, known_);
    for (const int i : of.a) w[i] = -w[i];
    for (int j = 0; j < nk; ++j) w[of.known[j]] += known_[j];
    for (int k = 0; k < nz; ++k) w[of.z[k]] = of_z_[k];
}

void FollowersOf::add_response(const double* ds, double* dw) const {
    dense::zero(of_z_, pz);
    dense::gemv(nz, ns, V, ps, ds, of_z_);
    for (int k = 0; k < nz; ++k) dw[of.z[k]] += of_z_[k];
    for (const Entry& e : of.D) dw[e.row] += D(e) * of_z_[e.column];
    for (const Entry& e : of.J) dw[e.row] += J(e) * ds[e.column];
}

void FollowersOf::add_response_transposed(const double* dw, double* ds) const {
    for (int k = 0; k < nz; ++k) of_z_[k] = dw[of.z[k]];
    for (const Entry& e : of.D) of_z_[e.column] += D(e) * dw[e.row];
    for (const Entry& e : of.J) ds[e.column] += J(e) * dw[e.row];
    dense::gemv_t(nz, ns, V, ps, of_z_, ds);
}

}  // namespace mbocp
