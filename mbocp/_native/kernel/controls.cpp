#include "controls.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "small_ldl.hpp"

namespace mbocp {
using dense::padded;

namespace {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using MatrixMap = Eigen::Map<RowMatrix, 0, Eigen::OuterStride<>>;

// Relative size of the smallest eigenvalue above which a bound on it will do.
constexpr double well_conditioned = 2e-3;
constexpr int few_columns = 64;  // of the end condition and the state

// Negative eigenvalues of a symmetric matrix; -1 when it is singular.
int count_negative(const Eigen::VectorXd& eigenvalues) {
    const double largest = eigenvalues.cwiseAbs().maxCoeff();
    if (!(eigenvalues.cwiseAbs().minCoeff() > singular * largest)) return -1;
    return static_cast<int>((eigenvalues.array() < 0).count());
}

}  // namespace

struct EndMultiplier::Work {
    explicit Work(int n) : R(n, n), L(n, n), scale(n), scaled(n), eigen(n), pivot(static_cast<std::size_t>(n)) {}

    RowMatrix R, L;
    Eigen::VectorXd scale, scaled;
    Eigen::SelfAdjointEigenSolver<RowMatrix> eigen;
    std::vector<int> pivot;
};

EndMultiplier::EndMultiplier(const Problem& problem)
    : ng_(problem.ng), R_(static_cast<std::size_t>(padded(ng_)) * padded(ng_) + 4, 0.0),
      factors_(static_cast<std::size_t>(ng_) * padded(ng_) + 4, 0.0), work_(std::make_unique<Work>(ng_)) {}
EndMultiplier::~EndMultiplier() = default;

void EndMultiplier::clear() { std::fill(R_.begin(), R_.end(), 0.0); }

// Of the equilibrated matrix: signs and sizes of its eigenvalues, and what it is solved with.
bool EndMultiplier::factorise(Factorisation& result) {
    if (!ng_) return true;
    auto& [R, L, scale, scaled, eigen, pivot] = *work_;
    const int pg = padded(ng_);
    const MatrixMap given(R_.data(), ng_, ng_, Eigen::OuterStride<>(pg));
    R = given.selfadjointView<Eigen::Upper>();
    for (int i = 0; i < ng_; ++i) scale[i] = 1.0 / std::sqrt(std::max(std::abs(R(i, i)), 1e-300));
    for (int i = 0; i < ng_; ++i)
        for (int j = 0; j < ng_; ++j) factors_[i * pg + j] = R(i, j) = scale[i] * R(i, j) * scale[j];
    if (!R.allFinite()) return false;
    const bool is_regular = dense::factor(ng_, factors_.data(), pg, pivot.data()) > 0.0;
    if (is_regular && is_plain(result)) return true;
    eigen.compute(R, Eigen::EigenvaluesOnly);
    const int negative = count_negative(eigen.eigenvalues());
    if (negative < 0 || !is_regular) return false;
    result.negative += negative;
    result.end_condition = eigen.eigenvalues().cwiseAbs().minCoeff() / eigen.eigenvalues().cwiseAbs().maxCoeff();
    return true;
}

// Whether it is negative definite and so well conditioned that its inverse shows it, as mostly: eigenvalues, which take
// several times as long, are not needed then.
bool EndMultiplier::is_plain(Factorisation& result) {
    if (ng_ > dense::most_inverted) return false;
    const RowMatrix& R = work_->R;
    const MatrixMap inverse(factors_.data(), ng_, ng_, Eigen::OuterStride<>(padded(ng_)));
    const double bound = 1.0 / (R.norm() * inverse.norm());  // Frobenius norms are above the largest eigenvalues
    if (!(bound > well_conditioned)) return false;
    work_->L = -R;
    if (!dense::cholesky(ng_, work_->L.data(), ng_)) return false;
    result.negative += ng_, result.end_condition = bound;
    return true;
}

void EndMultiplier::solve(const Numbers& r, Numbers& eta) const {
    auto& [R, L, scale, scaled, eigen, pivot] = *work_;
    for (int i = 0; i < ng_; ++i) scaled[i] = -scale[i] * r[i];
    dense::solve_vector(ng_, factors_.data(), padded(ng_), pivot.data(), scaled.data());
    for (int i = 0; i < ng_; ++i) eta[i] = scale[i] * scaled[i];
}

Controls::Controls(const Problem& problem, Data& data, const Barrier& barrier, EndMultiplier& eta)
    : problem_(problem), data_(data), barrier_(barrier), eta_(eta),
      diagonal_(static_cast<std::size_t>(problem.kind().nu), 0.0) {
    const std::size_t columns = std::max(few_columns, padded(problem.ng) + padded(problem.nd));
    work_.allocate(2 * static_cast<std::size_t>(problem.kind().nu) * columns + 32);
}

bool Controls::eliminate(int n, const Form& form, Factorisation& result) {
    barrier_.add_to_controls(n, form.of_controls + padded(problem_.ng) + problem_.nd, form.ld);
    const auto eliminate = [&](auto nu) {
        if constexpr (nu() > 0) {
            const bool are_few = padded(problem_.ng) + padded(problem_.nd) <= few_columns;
            if (are_few ? eliminate_few<nu(), few_columns>(n, form, result) : eliminate_few<nu(), 0>(n, form, result))
                return true;
        }
        return eliminate_any(n, form, result);
    };
    return dense::for_few(data_[n].kind->nu, eliminate);
}

// By factors that stay in registers, with rows of work of that length, which the compiler knows, or of any where it is
// 0. False, with nothing changed that counts, where these cannot be trusted.
template <int Nu, int Columns>
bool Controls::eliminate_few(int n, const Form& form, Factorisation& result) {
    Stage& s = data_[n];
    const int nd = problem_.nd, ng = problem_.ng, px = padded(nd), pg = padded(ng), ld = form.ld;
    const int ldz = Columns ? Columns : pg + px;
    const double* U = form.of_controls;
    dense::SmallLdl<Nu> factors;
    if (!factors.factor(U + pg + nd, ld)) return false;
    factors.keep(s.Quu, padded(Nu));
    s.factors = ControlFactors::ldl;
    result.negative += factors.negative();
    Space space(work_.data());
    double *Y = space.take(Nu, ldz), *Z = space.take(Nu, ldz);
    using Place = typename dense::SmallLdl<Nu>::Place;
    const auto place_of = [&](int v) { return 4 * v < pg ? Place{s.Keta + 4 * v, pg} : Place{s.K + 4 * v - pg, px}; };
    factors.solve(U, ld, place_of, Y, Z, ldz, (pg + px) / 4);
    if (n > 0) {
        const Stage& before = data_[n - 1];
        dense::subtract_symmetric<Nu>(nd, Z + pg, Y + pg, ldz, form.of_state + pg, ld, before.P, px);
        for (int i = 0; i < nd && nd < px; ++i) dense::zero(before.P + i * px + nd, px - nd);
        if (ng) dense::subtract_tn<Nu>(nd, pg, Z + pg, ldz, Y, ldz, form.of_state, ld, before.S, pg);
    }
    double* R = eta_.matrix();
    for (int i = 0; i < ng; i += dense::width, R += dense::width * (pg + 1))
        dense::subtract_tn<Nu>(dense::width, pg - i, Z + i, ldz, Y + i, ldz, R, pg, R, pg);
    return true;
}

// By Cholesky's factors, or by LU where Quu is not definite.
bool Controls::eliminate_any(int n, const Form& form, Factorisation& result) {
    Stage& s = data_[n];
    const int nu = s.kind->nu, nd = problem_.nd, ng = problem_.ng, pu = padded(nu), px = padded(nd), pg = padded(ng);
    // K = -Quu^{-1} Qux, Keta = -Quu^{-1} QS_u.
    for (int i = 0; i < nu; ++i) {
        const double* row = form.of_controls + i * form.ld;
        for (int j = 0; j < nu; ++j) s.Quu[i * pu + j] = row[pg + nd + j];
        for (int j = 0; j < nd; ++j) s.K[i * px + j] = -row[pg + j];
        for (int g = 0; g < ng; ++g) s.Keta[i * pg + g] = -row[g];
    }
    if (!factorise(s, result)) return false;
    pass_on(n, form);
    return true;
}

// Factors of Quu, and with them the gains.
bool Controls::factorise(Stage& s, Factorisation& result) {
    const int nu = s.kind->nu, ng = problem_.ng, pu = padded(nu), px = padded(problem_.nd), pg = padded(ng);
    for (int i = 0; i < nu; ++i) diagonal_[i] = s.Quu[i * pu + i];
    if (dense::cholesky(nu, s.Quu, pu)) {
        s.factors = ControlFactors::cholesky;
        dense::cholesky_solve(nu, s.Quu, pu, s.K, px, px);
        if (ng) dense::cholesky_solve(nu, s.Quu, pu, s.Keta, pg, pg);
        return true;
    }
    // `cholesky` has spoilt the lower triangle: the upper one still holds Quu.
    for (int i = 0; i < nu; ++i)
        for (int j = 0; j < i; ++j) s.Quu[i * pu + j] = s.Quu[j * pu + i];
    for (int i = 0; i < nu; ++i) s.Quu[i * pu + i] = diagonal_[i];
    const MatrixMap map(s.Quu, nu, nu, Eigen::OuterStride<>(pu));
    if (!map.allFinite()) return false;
    const Eigen::SelfAdjointEigenSolver<RowMatrix> eigen(map, Eigen::EigenvaluesOnly);
    const int negative = count_negative(eigen.eigenvalues());
    if (negative < 0) return false;
    result.negative += negative;
    if (dense::lu_factor(nu, s.Quu, pu, s.control_pivot) == 0.0) return false;
    s.factors = ControlFactors::lu;
    dense::lu_solve(nu, s.Quu, pu, s.control_pivot, s.K, px, px);
    if (ng) dense::lu_solve(nu, s.Quu, pu, s.control_pivot, s.Keta, pg, pg);
    return true;
}

// What is left of the quadratic form and of the columns without the controls.
void Controls::pass_on(int n, const Form& form) {
    const Stage& s = data_[n];
    const int nu = s.kind->nu, nd = problem_.nd, ng = problem_.ng, px = padded(nd), pg = padded(ng), ld = form.ld;
    const double* U = form.of_controls;
    if (n > 0) {
        double* P = data_[n - 1].P;
        for (int i = 0; i < nd; ++i) {
            dense::copy(form.of_state + i * ld + pg, P + i * px, nd);
            dense::zero(P + i * px + nd, px - nd);
        }
        dense::gemm_tn(nd, nd, nu, U + pg, ld, s.K, px, P, px);
        dense::symmetrise(nd, P, px, nullptr, 0);
        for (int i = 0; i < nd; ++i) {
            dense::scaled(px, 0.5, P + i * px, P + i * px);
            dense::zero(P + i * px + nd, px - nd);
        }
    }
    if (!ng) return;
    if (n > 0) {
        double* S = data_[n - 1].S;
        for (int i = 0; i < nd; ++i) dense::copy(form.of_state + i * ld, S + i * pg, pg);
        dense::gemm_tn(nd, ng, nu, U + pg, ld, s.Keta, pg, S, pg);
    }
    dense::gemm_tn(ng, ng, nu, U, ld, s.Keta, pg, eta_.matrix(), pg);
}

void Controls::solve(const Stage& s, double* k) const {
    const int nu = s.kind->nu, pu = padded(nu);
    if (s.factors == ControlFactors::cholesky) return dense::cholesky_solve_vector(nu, s.Quu, pu, k);
    if (s.factors == ControlFactors::lu) return dense::lu_solve_vector(nu, s.Quu, pu, s.control_pivot, k);
    dense::for_few(nu, [&](auto n) {
        if constexpr (n() > 0) dense::ldl_solve_vector<n()>(s.Quu, pu, k);
    });
}

}  // namespace mbocp
