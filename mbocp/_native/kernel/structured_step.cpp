#include "structured_step.hpp"

#include <algorithm>

namespace mbocp {

StructuredStep::StructuredStep(const Problem& problem, Data& data)
    : problem_(problem), data_(data), z_(2 * static_cast<std::size_t>(problem.kind().nw() + problem.kind().ns()), 0.0) {
    work_.allocate(problem.kind().structure->work_size());
}

void StructuredStep::add_places(Places& places) const {
    const Stage& s = data_[0];
    const StageFunction& f = *s.kind->complete;
    const auto add = [&](int output, const double* block) {
        for (int k = 0; k < f.outputs[output].nnz(); ++k)
            places.push_back({f.first[output] + k, static_cast<int>(block - s.begin()) + k});
    };
    add(2, s.J), add(4, s.H);
}

void StructuredStep::receive(int n) {
    const Stage& s = data_[n];
    s.kind->hessian.halve_diagonal(s.H);
}

void StructuredStep::store_first(int n, const StageFunction& f) {
    const Stage& s = data_[n];
    const Kind& k = *s.kind;
    dense::zero(s.J, k.complete->outputs[2].nnz());
    for (std::size_t i = 0; i < k.first_place.size(); ++i) s.J[k.first_place[i]] = f.res[2][i];
}

void StructuredStep::add_jacobian(int n, const double* dw, const double* ds, double* c) const {
    const Stage& s = data_[n];
    s.kind->structure->Jw.times(s.J, dw, c);
    s.kind->structure->Js.times(s.J, ds, c);
}

void StructuredStep::add_jacobian_transposed(int n, const double* dm, double* w, double* s) const {
    const Stage& at = data_[n];
    if (w) at.kind->structure->Jw.transposed_times(at.J, dm, w);
    if (s) at.kind->structure->Js.transposed_times(at.J, dm, s);
}

void StructuredStep::add_hessian(int n, const double* dw, const double* ds, double* w, double* s) const {
    const Stage& at = data_[n];
    const int nw = at.kind->nw(), ns = at.kind->ns();
    double *z = z_.data(), *Hz = z + nw + ns;
    dense::copy(dw, z, nw), dense::copy(ds, z + nw, ns);
    dense::zero(Hz, nw + ns);
    at.kind->hessian.times(at.H, z, Hz);
    for (int i = 0; i < nw; ++i) w[i] += Hz[i];
    for (int i = 0; i < ns; ++i) s[i] += Hz[nw + i];
}

void StructuredStep::copy_state_jacobian(int n, double* F, int ld) const {
    const Stage& s = data_[n];
    const int ndx = problem_.ndx;
    const SparseRows& Jw = s.kind->structure->Jw;
    dense::zero(F, ndx * ld);
    for (int i = 0; i < ndx; ++i)
        for (int k = Jw.start[i]; k < Jw.start[i + 1]; ++k)
            if (Jw.column[k] < ndx) F[i * ld + Jw.column[k]] = s.J[Jw.index[k]];
}

double StructuredStep::factor(int n) {
    Stage& s = data_[n];
    return s.kind->structure->factor(s.J, s.step, work_.data());
}

double StructuredStep::factor_first(int n, const StageFunction& f) {
    store_first(n, f);
    return factor(n);
}

void StructuredStep::solve(int n, double* c) const {
    const Stage& s = data_[n];
    s.kind->structure->solve_vector(s.J, s.step, c, work_.data());
}

void StructuredStep::solve_transposed(int n, double* w) const {
    const Stage& s = data_[n];
    s.kind->structure->solve_transposed(s.J, s.step, w, work_.data());
}

void StructuredStep::respond(int n, const double* ds, double* dw) const {
    const Stage& s = data_[n];
    dense::zero(dw, s.kind->nw());
    s.kind->structure->Js.times(s.J, ds, dw, -1.0);
    solve(n, dw);
}

}  // namespace mbocp
