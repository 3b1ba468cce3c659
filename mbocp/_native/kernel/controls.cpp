#include "controls.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

namespace mbocp {
using dense::padded;

namespace {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using MatrixMap = Eigen::Map<RowMatrix, 0, Eigen::OuterStride<>>;

// Negative eigenvalues of a symmetric matrix; -1 when it is singular.
int count_negative(const Eigen::VectorXd& eigenvalues) {
    const double largest = eigenvalues.cwiseAbs().maxCoeff();
    if (!(eigenvalues.cwiseAbs().minCoeff() > singular * largest)) return -1;
    return static_cast<int>((eigenvalues.array() < 0).count());
}

}  // namespace

EndMultiplier::EndMultiplier(const Problem& problem)
    : ng_(problem.ng), R_(static_cast<std::size_t>(padded(ng_)) * padded(ng_) + 4, 0.0) {}

void EndMultiplier::clear() { std::fill(R_.begin(), R_.end(), 0.0); }

// Eigenvectors of the equilibrated matrix: ng is small, and inertia comes for free.
bool EndMultiplier::factorise(Factorisation& result) {
    if (!ng_) return true;
    RowMatrix R = MatrixMap(R_.data(), ng_, ng_, Eigen::OuterStride<>(padded(ng_)));
    R = 0.5 * (R + R.transpose()).eval();
    Eigen::VectorXd scale(ng_);
    for (int i = 0; i < ng_; ++i) scale[i] = 1.0 / std::sqrt(std::max(std::abs(R(i, i)), 1e-300));
    R = scale.asDiagonal() * R * scale.asDiagonal();
    if (!R.allFinite()) return false;
    const Eigen::SelfAdjointEigenSolver<RowMatrix> eigen(R);
    const int negative = count_negative(eigen.eigenvalues());
    if (negative < 0) return false;
    result.negative += negative;
    result.end_condition = eigen.eigenvalues().cwiseAbs().minCoeff() / eigen.eigenvalues().cwiseAbs().maxCoeff();
    const RowMatrix inverse = scale.asDiagonal() * eigen.eigenvectors() *
                              eigen.eigenvalues().cwiseInverse().asDiagonal() * eigen.eigenvectors().transpose() *
                              scale.asDiagonal();
    inverse_.assign(inverse.data(), inverse.data() + inverse.size());
    return true;
}

void EndMultiplier::solve(const Numbers& r, Numbers& eta) const {
    std::fill(eta.begin(), eta.end(), 0.0);
    if (ng_) dense::gemv(ng_, ng_, inverse_.data(), ng_, r.data(), eta.data(), -1.0);
}

Controls::Controls(const Problem& problem, Data& data, const Barrier& barrier, EndMultiplier& eta)
    : problem_(problem), data_(data), barrier_(barrier), eta_(eta),
      diagonal_(static_cast<std::size_t>(problem.max_nu), 0.0) {}

// Factors of Quu, and with them the gains.
bool Controls::factorise(Stage& s, Factorisation& result) {
    const int nu = s.kind->nu, ng = problem_.ng, pu = padded(nu), px = padded(problem_.nd), pg = padded(ng);
    for (int i = 0; i < nu; ++i) diagonal_[i] = s.Quu[i * pu + i];
    s.definite = dense::cholesky(nu, s.Quu, pu);
    if (s.definite) {
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
    dense::lu_solve(nu, s.Quu, pu, s.control_pivot, s.K, px, px);
    if (ng) dense::lu_solve(nu, s.Quu, pu, s.control_pivot, s.Keta, pg, pg);
    return true;
}

// What is left of the quadratic form and of the columns without the controls.
void Controls::pass_on(int n, const double* QS, const double* kept) {
    const Stage& s = data_[n];
    const int nu = s.kind->nu, nd = problem_.nd, ng = problem_.ng, px = padded(nd), pg = padded(ng);
    if (n > 0) {
        double* P = data_[n - 1].P;
        dense::gemm_tn(nd, nd, nu, kept, px, s.K, px, P, px);
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < i; ++j) {
                const double mean = 0.5 * (P[i * px + j] + P[j * px + i]);
                P[i * px + j] = P[j * px + i] = mean;
            }
    }
    if (!ng) return;
    if (n > 0) {
        double* S = data_[n - 1].S;
        dense::copy(QS, S, nd * pg);
        dense::gemm_tn(nd, ng, nu, kept, px, s.Keta, pg, S, pg);
    }
    dense::gemm_tn(ng, ng, nu, QS + nd * pg, pg, s.Keta, pg, eta_.matrix(), pg);
}

void Controls::solve(const Stage& s, double* k) const {
    const int nu = s.kind->nu, pu = padded(nu);
    if (s.definite)
        dense::cholesky_solve_vector(nu, s.Quu, pu, k);
    else
        dense::lu_solve_vector(nu, s.Quu, pu, s.control_pivot, k);
}

}  // namespace mbocp
