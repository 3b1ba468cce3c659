// The last part of condensing a stage, the same for all its forms.
#pragma once

#include <Eigen/Dense>

#include "programme.hpp"

namespace mbocp {

using RowMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using MatrixMap = Eigen::Map<RowMatrix, 0, Eigen::OuterStride<>>;

inline constexpr double singular = 1e-15;  // relative pivot or eigenvalue below which a matrix counts as singular

// Negative eigenvalues of a symmetric matrix; -1 when it is singular.
inline int count_negative(const Eigen::VectorXd& eigenvalues) {
    const double largest = eigenvalues.cwiseAbs().maxCoeff();
    if (!(eigenvalues.cwiseAbs().minCoeff() > singular * largest)) return -1;
    return static_cast<int>((eigenvalues.array() < 0).count());
}

template <class Quadratic>
bool Programme::eliminate_controls(int n, Quadratic q, const double* QS, double* kept, Factorisation& result) {
    using dense::padded;
    Stage& s = stages_[n];
    const int nu = s.kind->nu, nd = nd_, pu = padded(nu), px = padded(nd), pg = padded(ng_);

    // Controls: K = -Quu^{-1} Qux, Keta = -Quu^{-1} QS_u.
    for (int i = 0; i < nu; ++i) {
        for (int j = 0; j < nu; ++j) s.Quu[i * pu + j] = q(nd + i, nd + j);
        for (int j = 0; j < nd; ++j) s.K[i * px + j] = -q(nd + i, j);
        for (int g = 0; g < ng_; ++g) s.Keta[i * pg + g] = -QS[(nd + i) * pg + g];
    }
    for (std::size_t i = 0; i < limits_.u.size(); ++i)
        s.Quu[limits_.u[i] * (pu + 1)] += limits_.sigma[n * limits_.rows + limits_.x.size() + i];
    for (int i = 0; i < nu; ++i) diagonal_[i] = s.Quu[i * pu + i];
    double* P_before = n > 0 ? stages_[n - 1].P : nullptr;
    if (P_before)
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < nd; ++j) P_before[i * px + j] = q(i, j);
    for (int i = 0; i < nu * px; ++i) kept[i] = -s.K[i];
    s.definite = dense::cholesky(nu, s.Quu, pu);
    if (s.definite) {
        dense::cholesky_solve(nu, s.Quu, pu, s.K, px, px);
        if (ng_) dense::cholesky_solve(nu, s.Quu, pu, s.Keta, pg, pg);
    } else {
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
        if (ng_) dense::lu_solve(nu, s.Quu, pu, s.control_pivot, s.Keta, pg, pg);
    }

    if (P_before) {
        dense::gemm_tn(nd, nd, nu, kept, px, s.K, px, P_before, px);
        for (int i = 0; i < nd; ++i)
            for (int j = 0; j < i; ++j) {
                const double mean = 0.5 * (P_before[i * px + j] + P_before[j * px + i]);
                P_before[i * px + j] = P_before[j * px + i] = mean;
            }
    }
    if (ng_) {
        if (n > 0) {
            double* S_before = stages_[n - 1].S;
            dense::copy(QS, S_before, nd * pg);
            dense::gemm_tn(nd, ng_, nu, kept, px, s.Keta, pg, S_before, pg);
        }
        dense::gemm_tn(ng_, ng_, nu, QS + nd * pg, pg, s.Keta, pg, R_.data(), pg);
    }
    return true;
}

}  // namespace mbocp
