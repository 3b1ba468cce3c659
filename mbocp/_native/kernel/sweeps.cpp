#include "sweeps.hpp"

#include <Eigen/QR>
#include <Eigen/SVD>
#include <cmath>

namespace mbocp {

namespace {

constexpr double tolerance = 1e-13;  // of a step's equations in the programme's scaling: round-off
constexpr int most_iterations = 50;
constexpr double rank = 1e-12;  // relative singular value of G below which it adds nothing

using Matrix = Eigen::MatrixXd;
using Vector = Eigen::VectorXd;

// Smallest x for which A x - b is smallest; NaN where A or b has left the finite numbers.
Vector least_squares(const Matrix& A, const Vector& b) {
    if (!(A.allFinite() && b.allFinite())) return Vector::Constant(A.cols(), std::nan(""));
    const Eigen::HouseholderQR<Matrix> qr(A);
    const Eigen::Index size = std::min(A.rows(), A.cols());
    const Matrix R = qr.matrixQR().topRows(size).triangularView<Eigen::Upper>();
    const Vector c = (qr.householderQ().adjoint() * b).head(size);
    Eigen::JacobiSVD<Matrix> svd(R, Eigen::ComputeThinU | Eigen::ComputeThinV);
    svd.setThreshold(rank);
    return svd.solve(c);
}

}  // namespace

SweepOutcome sweep(Programme& programme, bool auxiliary, bool feedback) {
    SweepOutcome out;
    const Sweep forward = programme.simulate(tolerance, most_iterations, true, feedback, false);
    if (!forward.ok)
        out.failed_stage = forward.failed_stage;
    else
        out.evaluation = programme.gradient(auxiliary, feedback);
    return out;
}

Evaluation find_end_multiplier(Programme& programme, bool auxiliary, bool feedback) {
    using Row = Eigen::Map<const Eigen::ArrayXd>;
    const int ng = programme.problem.ng;
    if (ng > 0) {
        const Numbers scale = programme.data.control_scale(), h = programme.data.control_gradient();
        const Numbers G = programme.adjoint_sweep.end_sensitivity(feedback);
        const Row factor(scale.data(), static_cast<Eigen::Index>(scale.size()));
        const Row gradient(h.data(), static_cast<Eigen::Index>(h.size()));
        const Eigen::Map<const Matrix> transposed(G.data(), factor.size(), ng);
        // In the scaling of the gradient and the metric of the controls: G scale / sqrt(scale), h / sqrt(scale).
        const Vector change =
            least_squares(factor.sqrt().matrix().asDiagonal() * transposed, -(gradient / factor.sqrt()).matrix());
        for (int i = 0; i < ng; ++i) programme.iterate.eta[i] += change[i];
    }
    return programme.gradient(auxiliary, feedback);
}

}  // namespace mbocp
