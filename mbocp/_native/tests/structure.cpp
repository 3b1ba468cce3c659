// Steps with constraints, through the constraints' null space, against the LU of the whole step's matrix.
#include "../kernel/structure.hpp"

#include "checks.hpp"
#include "patterns.hpp"

namespace mbocp::tests {
namespace {

constexpr int nq = 9, ny = 4, nr = 2, nu = 3, d = nq - ny, ndx = 2 * nq + nr, nw = ndx + ny, nd = 2 * d + nr;
constexpr double dt = 0.1;

// A chain of two groups with columns of their own, and a loop that is closed among what they leave free.
const std::vector<GroupOfRows> groups{{0, 2, {0, 1, 2}}, {2, 1, {3, 4, 5, 6}}, {3, 1, {}}};

// Derivatives of a step's rows by (q, v, r, y, q before, v before, r before, u), see structure.hpp.
Matrix random_jacobian(Random& random) {
    Matrix J = Matrix::Zero(nw, nw + ndx + nu);
    const Matrix one = Matrix::Identity(nq, nq);
    Matrix G = random.matrix(ny, nq);
    G.block(0, 3, 2, nq - 3).setZero(), G.block(2, 7, 1, nq - 7).setZero();
    J.block(0, 0, nq, nq) = -one, J.block(0, nq, nq, nq) = dt * one, J.block(0, nw, nq, nq) = one;
    J.block(nq, 0, nq, nq) = random.matrix(nq, nq), J.block(nq, nq, nq, nq) = random.definite(nq);
    J.block(nq, ndx, nq, ny) = -G.transpose();
    J.block(nq, nw, nq, 2 * nq) = random.matrix(nq, 2 * nq), J.block(nq, nw + ndx, nq, nu) = random.matrix(nq, nu);
    J.block(2 * nq, 2 * nq, nr, nr) = -Matrix::Identity(nr, nr);
    J.block(2 * nq, nw + ndx, nr, nu) = random.matrix(nr, nu);
    J.block(ndx, 0, ny, nq) = G / dt;
    return J;
}

// A step with factors and the memory that these take.
struct Factored {
    Sparse jacobian;
    Structure structure{jacobian.pattern, ndx, ny, nu, groups};
    Numbers doubles, work;
    std::vector<int> ints;
    StepFactor f;
    double regularity = 0;

    explicit Factored(const Matrix& J)
        : jacobian(sparse_of(J)), doubles(structure.num_doubles()), work(structure.work_size()),
          ints(structure.num_ints()) {
        structure.place(f, doubles.data(), ints.data());
        regularity = structure.factor(values(), f, work.data());
    }
    const double* values() const { return jacobian.values.data(); }
    Matrix Jw() const { return jacobian.matrix.leftCols(nw); }
    Matrix Gd() const { return Jw().bottomLeftCorner(ny, nq); }
    Matrix N() const { return Eigen::Map<const Matrix>(f.N, nq, dense::padded(d)).leftCols(d); }
    Matrix basis() const {
        Padded B(ndx, nd);
        structure.basis(f, B.data());
        return B.matrix();
    }
};

TEST(steps_with_constraints) {
    Random random(21);
    for (int trial = 0; trial < 40; ++trial) {
        Factored step(random_jacobian(random));
        const Structure& s = step.structure;
        const Eigen::PartialPivLU<Matrix> lu(step.Jw()), transposed(step.Jw().transpose());
        const double scale = 1000.0 / lu.rcond();
        check(s.nq == nq && s.nr == nr && s.d == d && s.nd() == nd, "sizes");
        check(step.regularity > 0.0, "singular");
        check_equal(step.Gd() * step.N(), Matrix::Zero(ny, d), scale, "null space");
        for (int e = 0; e < d; ++e)
            check(step.N().row(step.f.free[e]) == Matrix::Identity(d, d).row(e), "free columns");
        const Vector b = random.vector(nw);
        Vector x = b, y = b;
        s.solve_vector(step.values(), step.f, x.data(), step.work.data());
        check_equal(x, lu.solve(b), scale, "solve_vector");
        s.solve_transposed(step.values(), step.f, y.data(), step.work.data());
        check_equal(y, transposed.solve(b), scale, "solve_transposed");
        Padded C(random.matrix(ny, d)), X(nq, d);
        s.particular_matrix(step.values(), step.f, C.data(), X.data(), step.work.data());
        check_equal(step.Gd() * X.matrix(), C.matrix(), scale, "particular_matrix");
        for (int e = 0; e < d; ++e) check(X.matrix().row(step.f.free[e]).isZero(0.0), "particular in free columns");
        // Multipliers of the momentum rows from states, controls and these rows' residual.
        const Vector state = random.vector(ndx), before = random.vector(ndx + nu);
        const Matrix Jm = step.jacobian.matrix.middleRows(nq, nq);
        const Vector multipliers = random.vector(ny);
        const Vector rest = Jm.leftCols(ndx) * state + Jm.rightCols(ndx + nu) * before;
        const Vector cm = dt * step.Gd().transpose() * multipliers - rest;
        Vector found(ny);
        s.balance(step.values(), step.f, state.data(), before.data(), cm.data(), found.data(), step.work.data());
        check_equal(found, multipliers, scale, "balance");
    }
}

TEST(reachable_states) {
    Random random(22);
    for (int trial = 0; trial < 40; ++trial) {
        Factored before(random_jacobian(random)), step(random_jacobian(random));
        const Structure& s = step.structure;
        s.reach(before.f, nullptr, before.work.data());
        s.reach(step.f, &before.f, step.work.data());
        const Matrix B = step.basis(), V = B.middleRows(nq, nq);
        const double scale = 1e4 * (1.0 + B.cwiseAbs().maxCoeff()) * (1.0 + B.cwiseAbs().maxCoeff());
        // A step that changes alpha and gamma: dq = N alpha, and dv = (dq - dq before) / dt as far as gamma says.
        Matrix C(d, d);
        for (int j = 0; j < d; ++j) C.row(j) = step.N().row(before.f.free[j]);
        check_equal(V.leftCols(d), (step.N() - before.N() * C) / dt, scale / dt, "reach: alpha");
        check_equal(V.middleCols(d, d), before.N(), 0.0, "reach: gamma");
        const Vector xi = random.vector(nd), h = random.vector(ndx), dx = random.vector(ndx);
        Padded coordinates(xi.transpose()), g(1, nd), Y(random.matrix(ndx, nd)), M(nd, nd), gram(nd, nd);
        Vector moved = dx;
        s.expand(step.f, coordinates.data(), moved.data(), -0.3);
        check_equal(moved, dx - 0.3 * B * xi, scale, "expand");
        s.project(step.f, h.data(), g.data());
        check_equal(g.matrix().transpose(), B.transpose() * h, scale, "project");
        s.project_matrix(step.f, Y.data(), M.data(), M.ld);
        check_equal(M.matrix(), B.transpose() * Y.matrix(), scale, "project_matrix");
        s.gram(step.f, gram.data(), gram.ld);
        check_equal(gram.matrix(), B.transpose() * B, scale, "gram");
        // Multipliers in two parts are those of the whole.
        const Vector b = random.vector(nw);
        Padded along((step.N().transpose() * (dt * b.head(nq) + b.segment(nq, nq))).transpose());
        Vector mm(nq), parts = b, whole = b;
        s.momentum_multipliers(step.values(), step.f, along.data(), b.data() + ndx, mm.data(), step.work.data());
        s.other_multipliers(step.values(), step.f, parts.data(), mm.data(), step.work.data());
        s.solve_transposed(step.values(), step.f, whole.data(), step.work.data());
        check_equal(parts, whole, 1e4 * whole.cwiseAbs().maxCoeff(), "multipliers in two parts");
    }
}

TEST(dependent_constraints) {
    Random random(23);
    for (const int row : {1, 3}) {
        Matrix J = random_jacobian(random);
        J.row(ndx + row).setZero(), J.col(ndx + row).setZero();
        J(ndx + row, 0) = J(ndx, 0) * 1e-18;  // the pattern is there, the row is next to none
        if (row == 3) J.row(ndx + 3).head(nq) = J.row(ndx).head(nq) + J.row(ndx + 2).head(nq);
        J.block(nq, ndx + row, nq, 1) = -dt * J.block(ndx + row, 0, 1, nq).transpose();
        check(Factored(J).regularity == 0.0, "dependent constraints are taken");
    }
}

}  // namespace
}  // namespace mbocp::tests
