#include "reduced_hessian.hpp"

#include <algorithm>
#include <stdexcept>

#include "controls.hpp"

namespace mbocp {
using dense::padded;

namespace {

class Columns {
public:
    Columns(const Problem& problem, const Data& data, const Step& step, double shift)
        : problem_(problem), data_(data), step_(step), shift_(shift), d_(problem), p_(problem.ndx, 0.0) {
        work_.allocate(3 * static_cast<std::size_t>(problem.kind().nw() + problem.kind().ns()) + 64);
    }

    // The response of end condition and control gradients to one entry of (eta, u).
    void find(int column, double* out) {
        const int ng = problem_.ng;
        std::fill(d_.deta.begin(), d_.deta.end(), 0.0), std::fill(d_.du.begin(), d_.du.end(), 0.0);
        std::fill(d_.dx.begin(), d_.dx.end(), 0.0), std::fill(d_.dy.begin(), d_.dy.end(), 0.0);
        (column < ng ? d_.deta[column] : d_.du[column - ng]) = 1.0;
        int first = problem_.N;  // stage that moves
        if (column >= ng)
            for (first = 0; problem_.u_offset[first + 1] <= column - ng;) ++first;
        for (int n = first; n < problem_.N; ++n) move_state(n);
        move_end(out);
        for (int n = problem_.N - 1; n >= 0; --n) move_adjoint(n, out + ng + problem_.u_offset[n]);
    }

private:
    void read_before(int n, double* ds) const {
        dense::copy(d_.dx.data() + problem_.dx_offset(n), ds, problem_.ndx);
        dense::copy(d_.du.data() + problem_.u_offset[n], ds + problem_.ndx, problem_.kind().nu);
    }

    void move_state(int n) {
        const Kind& k = problem_.kind();
        Space space(work_.data());
        double *ds = space.take(k.ns()), *dw = space.take(k.nw());
        read_before(n, ds);
        step_.respond(n, ds, dw);
        dense::copy(dw, d_.dx.data() + problem_.dx_offset(n + 1), problem_.ndx);
        dense::copy(dw + problem_.ndx, d_.dy.data() + problem_.y_offset[n], k.ny);
    }

    void move_end(double* out) {
        const int nd = problem_.ndx, ng = problem_.ng, px = padded(nd), pg = padded(ng);
        const End& end = data_.end;
        const double* dx = d_.dx.data() + problem_.dx_offset(problem_.N);
        std::fill(out, out + ng, 0.0), std::fill(p_.begin(), p_.end(), 0.0);
        dense::gemv_t(nd, ng, end.S.data(), pg, dx, out);
        dense::gemv(nd, nd, end.H.data(), px, dx, p_.data());
        dense::gemv(nd, ng, end.S.data(), pg, d_.deta.data(), p_.data());
    }

    void move_adjoint(int n, double* of_u) {
        const Kind& k = problem_.kind();
        const int nd = problem_.ndx, nw = k.nw(), ns = k.ns();
        Space space(work_.data());
        double *ds = space.take(ns), *dw = space.take(nw), *dm = space.zeros(nw), *hs = space.zeros(ns);
        read_before(n, ds);
        dense::copy(d_.dx.data() + problem_.dx_offset(n + 1), dw, nd);
        dense::copy(d_.dy.data() + problem_.y_offset[n], dw + nd, k.ny);
        step_.add_hessian(n, dw, ds, dm, hs);
        for (int i = 0; i < nd; ++i) dm[i] += p_[i] + shift_ * dw[i];
        for (int i = 0; i < nw; ++i) dm[i] = -dm[i];
        step_.solve_transposed(n, dm);
        step_.add_jacobian_transposed(n, dm, nullptr, hs);
        dense::copy(hs, p_.data(), nd);
        dense::copy(hs + nd, of_u, k.nu);
    }

    const Problem& problem_;
    const Data& data_;
    const Step& step_;
    const double shift_;
    Increment d_;
    Numbers p_;
    Pool work_;
};

}  // namespace

Numbers reduced_hessian(const Problem& problem, const Data& data, Step& step, double shift) {
    for (int n = 0; n < problem.N; ++n)
        if (step.prepare_response(n, 0) < singular)
            throw std::runtime_error("reduced_hessian: the matrix of a step is singular");
    const int total = problem.ng + problem.u_offset[problem.N];
    Numbers K(static_cast<std::size_t>(total) * total, 0.0);
    Columns columns(problem, data, step, shift);
    for (int column = 0; column < total; ++column)  // symmetric: rows are columns
        columns.find(column, K.data() + static_cast<std::size_t>(column) * total);
    return K;
}

}  // namespace mbocp
