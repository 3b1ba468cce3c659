// The last parts of the elimination, the same for all its forms: a stage's controls, and the end condition's
// multiplier.
#pragma once

#include "barrier.hpp"
#include "data.hpp"

namespace mbocp {

inline constexpr double singular = 1e-15;  // relative pivot or eigenvalue below which a matrix counts as singular

// The Schur complement of eta, to which each stage adds.
class EndMultiplier {
public:
    explicit EndMultiplier(const Problem& problem);

    void clear();
    double* matrix() { return R_.data(); }  // rows of padded(ng)
    bool factorise(Factorisation& result);  // false where it is singular or not finite
    // eta <- -R^{-1} r
    void solve(const Numbers& r, Numbers& eta) const;

private:
    const int ng_;
    Numbers R_, inverse_;
};

// A stage's quadratic form q(i, j) over (state before, controls) with its columns of eta.
class Controls {
public:
    Controls(const Problem& problem, Data& data, const Barrier& barrier, EndMultiplier& eta);

    // Eliminates the controls of stage n: its gains, the remainder to the node before, and its share of eta's matrix.
    // `QS` holds the columns; `kept` is workspace of nu rows.
    template <class Quadratic>
    bool eliminate(int n, Quadratic q, const double* QS, double* kept, Factorisation& result);
    // k <- Quu^{-1} k
    void solve(const Stage& s, double* k) const;

private:
    bool factorise(Stage& s, Factorisation& result);
    void pass_on(int n, const double* QS, const double* kept);

    const Problem& problem_;
    Data& data_;
    const Barrier& barrier_;
    EndMultiplier& eta_;
    Numbers diagonal_;
};

template <class Quadratic>
bool Controls::eliminate(int n, Quadratic q, const double* QS, double* kept, Factorisation& result) {
    using dense::padded;
    Stage& s = data_[n];
    const int nu = s.kind->nu, nd = problem_.nd, ng = problem_.ng, pu = padded(nu), px = padded(nd), pg = padded(ng);

    // K = -Quu^{-1} Qux, Keta = -Quu^{-1} QS_u.
    for (int i = 0; i < nu; ++i) {
        for (int j = 0; j < nu; ++j) s.Quu[i * pu + j] = q(nd + i, nd + j);
        for (int j = 0; j < nd; ++j) s.K[i * px + j] = -q(nd + i, j);
        for (int g = 0; g < ng; ++g) s.Keta[i * pg + g] = -QS[(nd + i) * pg + g];
    }
    barrier_.add_to_controls(n, s.Quu, pu);
    double* P_before = n > 0 ? data_[n - 1].P : nullptr;
    if (P_before)
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < nd; ++j) P_before[i * px + j] = q(i, j);
    for (int i = 0; i < nu * px; ++i) kept[i] = -s.K[i];
    if (!factorise(s, result)) return false;
    pass_on(n, QS, kept);
    return true;
}

}  // namespace mbocp
