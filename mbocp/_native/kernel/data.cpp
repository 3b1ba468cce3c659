#include "data.hpp"

#include <algorithm>

#include "followers.hpp"

namespace mbocp {
using dense::padded;

namespace {

std::size_t product(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

// A stage's blocks one after another from `base` on, in the order in which the factorisation walks through them; null
// to measure them only. Returns their size.
std::size_t lay_out(const Problem& problem, const Kind& k, double* base, int* ints, Stage& s) {
    std::size_t at = 0;
    const auto take = [&](double*& target, std::size_t size) {
        if (base) target = base + at;
        at += (size + 3) / 4 * 4;
    };
    const int nd = problem.nd, ldd = padded(nd), ldg = padded(problem.ng);
    const int nw = k.nw(), ns = k.ns(), nc = k.nc(), pw = padded(nw), ps = padded(ns), pm = padded(nd + k.nu);
    double* step = nullptr;
    take(s.c, nc), take(s.gw, nw), take(s.gs, ns), take(s.lw, nw), take(s.ls, ns);
    if (k.structure) {
        take(s.J, k.complete->outputs[2].nnz()), take(s.H, k.complete->outputs[4].nnz());
        take(step, k.structure->num_doubles()), take(s.T, product(nd, pm)), take(s.Q, product(pm, pm));
        take(s.g, ldd + pm), take(s.b, problem.ndx);
    } else {
        take(s.Jw, product(nc, pw)), take(s.Js, product(nc, ps));
        take(s.Hww, product(pw, pw)), take(s.Hws, product(pw, ps)), take(s.Hss, product(ps, ps));
        take(s.LU, product(nc, pw)), take(s.lead, product(3 * k.lead, padded(k.lead))), take(s.T, product(pw, ps));
        take(s.V, size_of_followers(k));
    }
    take(s.Quu, product(k.nu, padded(k.nu))), take(s.K, product(padded(k.nu), ldd)), take(s.Keta, product(k.nu, ldg));
    take(s.P, product(ldd, ldd)), take(s.S, product(ldd, ldg));
    take(s.t0, nw), take(s.k, k.nu), take(s.p, nd), take(s.Hz, nw + ns);
    if (k.structure && base) k.structure->place(s.step, step, ints);
    return at;
}

}  // namespace

Data::Data(const Problem& problem) : end(problem), ndx_(problem.ndx) {
    // Pivots of the controls, then a dense step's, or the chosen entries and the structure's.
    const Kind& k = problem.kind();
    const int num_ints = k.nu + (k.structure ? problem.nd + static_cast<int>(k.structure->num_ints()) : k.nc());
    const std::size_t N = static_cast<std::size_t>(problem.N);
    Stage unused{};
    pivots_.assign(N * static_cast<std::size_t>(num_ints), 0);
    double* base = pool_.allocate(N * lay_out(problem, k, nullptr, nullptr, unused) + 8);
    int* at = pivots_.data();
    for (int n = 0; n < problem.N; ++n) {
        Stage s{};
        s.kind = &k, s.factors = ControlFactors::cholesky;
        s.control_pivot = at, s.pivot = s.chosen = at + k.nu;
        base += lay_out(problem, k, base, at + k.nu + problem.nd, s);
        at += num_ints;
        stages_.push_back(s);
    }
}

Numbers Data::costates() const {
    Numbers out;
    for (const Stage& s : stages_) out.insert(out.end(), s.gs, s.gs + ndx_);
    out.insert(out.end(), end.r_x.begin(), end.r_x.end());
    return out;
}

Numbers Data::control_gradient() const {
    Numbers out;
    for (const Stage& s : stages_)
        for (int i = 0; i < s.kind->nu; ++i) out.push_back(s.gs[ndx_ + i] * s.kind->scale_ru[i]);
    return out;
}

Numbers Data::control_scale() const {
    Numbers out;
    for (const Stage& s : stages_) out.insert(out.end(), s.kind->scale_ru.begin(), s.kind->scale_ru.end());
    return out;
}

End::End(const Problem& p)
    : H(product(padded(p.ndx), padded(p.ndx)), 0.0), S(product(p.ndx, padded(p.ng)), 0.0), g(p.ng, 0.0),
      psi_x(p.ndx, 0.0), r_x(p.ndx, 0.0) {}

bool End::evaluate(const Problem& p, const Iterate& at, Evaluation& e) {
    StageFunction& f = *p.terminal.complete;
    f.arg[0] = at.x.data() + p.x_offset(p.N);
    f.arg[1] = at.eta.data();
    f.arg[2] = p.rho_terminal.data();
    const bool ok = f.call();
    const int ldx = padded(p.ndx), ldg = padded(p.ng);
    const auto &of_g = f.outputs[1], &of_S = f.outputs[2], &of_psi = f.outputs[3], &of_H = f.outputs[4];
    e.cost += f.outputs[0].nnz() ? f.res[0][0] : 0.0;
    for (int i = 0; i < of_g.nnz(); ++i) g[of_g.row[i]] = f.res[1][i];
    for (int i = 0; i < of_S.nnz(); ++i) S[of_S.column[i] * ldg + of_S.row[i]] = f.res[2][i];
    for (int i = 0; i < of_psi.nnz(); ++i) psi_x[std::max(of_psi.row[i], of_psi.column[i])] = f.res[3][i];
    for (int i = 0; i < of_H.nnz(); ++i) {
        const int a = of_H.row[i], b = of_H.column[i];
        H[a * ldx + b] = H[b * ldx + a] = f.res[4][i];
    }
    dense::copy(psi_x.data(), r_x.data(), p.ndx);
    dense::gemv(p.ndx, p.ng, S.data(), ldg, at.eta.data(), r_x.data());
    return ok;
}

}  // namespace mbocp
