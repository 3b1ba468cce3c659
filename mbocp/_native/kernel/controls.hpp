// The last parts of the elimination, the same for all its forms: a stage's controls, and the end condition's
// multiplier.
#pragma once

#include <memory>

#include "barrier.hpp"
#include "data.hpp"

namespace mbocp {

inline constexpr double singular = 1e-15;  // relative pivot or eigenvalue below which a matrix counts as singular

// The Schur complement of eta, to which each stage adds.
class EndMultiplier {
public:
    explicit EndMultiplier(const Problem& problem);
    ~EndMultiplier();

    void clear();
    double* matrix() { return R_.data(); }  // rows of padded(ng); of it the upper triangle counts
    bool factorise(Factorisation& result);  // false where it is singular or not finite
    // eta <- -R^{-1} r
    void solve(const Numbers& r, Numbers& eta) const;

private:
    bool is_plain(Factorisation& result);

    struct Work;  // of the factorisation, as large as it has to be from the beginning

    const int ng_;
    Numbers R_, factors_;
    std::unique_ptr<Work> work_;
};

// A stage's quadratic form over (state before, controls), with the columns of eta in front: rows of the state before
// and of the controls, each (S, padded(ng) | state before, nd | controls, nu | padding), of length ld. Only the
// symmetric part of the state's block counts, and what its rows have in the controls' columns does not.
struct Form {
    double *of_state, *of_controls;
    int ld;
};

class Controls {
public:
    Controls(const Problem& problem, Data& data, const Barrier& barrier, EndMultiplier& eta);

    // Eliminates the controls of stage n: its gains, the remainder to the node before, and its share of eta's matrix.
    bool eliminate(int n, const Form& form, Factorisation& result);
    // k <- Quu^{-1} k
    void solve(const Stage& s, double* k) const;

private:
    template <int Nu, int Columns>
    bool eliminate_few(int n, const Form& form, Factorisation& result);
    bool eliminate_any(int n, const Form& form, Factorisation& result);
    bool factorise(Stage& s, Factorisation& result);
    void pass_on(int n, const Form& form);

    const Problem& problem_;
    Data& data_;
    const Barrier& barrier_;
    EndMultiplier& eta_;
    Numbers diagonal_;
    Pool work_;
};

}  // namespace mbocp
