// Small dense algebra and factorisations against Eigen, at all sizes that have code of their own, and some beyond.
#include "../kernel/dense.hpp"

#include "../kernel/small_ldl.hpp"
#include "checks.hpp"

namespace mbocp::tests {
namespace {

std::string of_size(const char* what, int m, int n = 0, int k = 0) {
    return std::string(what) + " of " + std::to_string(m) + ", " + std::to_string(n) + ", " + std::to_string(k);
}

TEST(vectors) {
    Random random(1);
    for (int n = 0; n < 80; ++n) {
        const Vector x = random.vector(n), y = random.vector(n);
        const double scale = 4.0 * (n + 1);
        check_equal(dense::dot(n, x.data(), y.data()), x.dot(y), scale, of_size("dot", n));
        check(dense::largest(n, x.data()) == (n ? x.cwiseAbs().maxCoeff() : 0.0), of_size("largest", n));
        const Vector weighted = x.cwiseProduct(y);
        check_equal(dense::weighted_squares(n, x.data(), y.data()), weighted.squaredNorm(), 40.0 * scale,
                    of_size("weighted_squares", n));
        check(dense::weighted_largest(n, x.data(), y.data()) == (n ? weighted.cwiseAbs().maxCoeff() : 0.0),
              of_size("weighted_largest", n));
        Vector z = y;
        dense::axpy(n, 0.3, x.data(), z.data());
        check_equal(z, y + 0.3 * x, 8.0, of_size("axpy", n));
        dense::copy(x.data(), z.data(), n);
        check(z == x, of_size("copy", n));
        dense::zero(z.data(), n);
        check(z == Vector::Zero(n), of_size("zero", n));
        Padded a(x.transpose()), b(y.transpose()), c(1, n), apart(random.matrix(n, 3));
        dense::multiply_add(n, a.data(), b.data(), c.data());
        check_equal(c.matrix(), weighted.transpose(), 8.0, of_size("multiply_add", n));
        dense::scaled(n, 0.3, a.data(), c.data());
        check_equal(c.matrix(), 0.3 * x.transpose(), 4.0, of_size("scaled", n));
        dense::gather(n, 0.3, apart.data() + 1, apart.ld, c.data());
        check_equal(c.matrix(), 0.3 * apart.matrix().col(1).transpose(), 4.0, of_size("gather", n));
    }
}

TEST(products) {
    Random random(2);
    for (int trial = 0; trial < 300; ++trial) {
        const int m = random.integer(1, 30), n = random.integer(1, 30), k = random.integer(1, 30);
        const Matrix A = random.matrix(m, k), B = random.matrix(k, n), C = random.matrix(m, n);
        const Vector x = random.vector(k), y = random.vector(m);
        const double scale = 30.0 * k;
        Padded a(A), at(A.transpose()), b(B), sum(C), plain(C), scaled(C);
        dense::gemm_tn(m, n, k, at.data(), at.ld, b.data(), b.ld, sum.data(), sum.ld);
        check_equal(sum.matrix(), C + A * B, scale, of_size("gemm_tn", m, n, k));
        dense::for_few(k, [&](auto K) {
            dense::gemm_tn<K(), false>(m, n, k, at.data(), at.ld, b.data(), b.ld, plain.data(), plain.ld);
        });
        check_equal(plain.matrix(), A * B, scale, of_size("gemm_tn without C", m, n, k));
        dense::gemm_nn(m, n, k, a.data(), a.ld, b.data(), b.ld, scaled.data(), scaled.ld, -0.3);
        check_equal(scaled.matrix(), C - 0.3 * A * B, scale, of_size("gemm_nn", m, n, k));
        for (const bool is_padded : {true, false}) {
            Matrix tight = A, transposed = A.transpose();
            Vector z = y, w = y;
            dense::gemv(m, k, is_padded ? a.data() : tight.data(), is_padded ? a.ld : k, x.data(), z.data(), -0.3);
            check_equal(z, y - 0.3 * A * x, scale, of_size("gemv", m, k));
            dense::gemv_t(k, m, is_padded ? at.data() : transposed.data(), is_padded ? at.ld : m, x.data(), w.data(),
                          -0.3);
            check_equal(w, y - 0.3 * A * x, scale, of_size("gemv_t", m, k));
        }
        const Matrix S = random.matrix(m, m), H = random.definite(m);
        Padded s(S), h(H);
        dense::symmetrise(m, s.data(), s.ld, trial % 2 ? h.data() : nullptr, h.ld);
        check_equal(s.matrix(), Matrix(S + S.transpose() + (trial % 2) * H), 40.0, of_size("symmetrise", m));
    }
}

// What takes A to its factors and solves with these.
struct Solver {
    const char* name;
    double (*factor)(int, double*, int, int*);
    void (*solve)(int, const double*, int, const int*, double*, int, int);
    void (*solve_vector)(int, const double*, int, const int*, double*);
    void (*solve_transposed)(int, const double*, int, const int*, double*);
};
const Solver lu{"lu", dense::lu_factor, dense::lu_solve, dense::lu_solve_vector, dense::lu_solve_transposed};
const Solver best{"factor", dense::factor, dense::solve, dense::solve_vector, dense::solve_transposed};
const Solver cholesky{
    "cholesky", [](int n, double* A, int ld, int*) { return dense::cholesky(n, A, ld) ? 1.0 : 0.0; },
    [](int n, const double* L, int ld, const int*, double* B, int ldb, int m) {
        dense::cholesky_solve(n, L, ld, B, ldb, m);
    },
    [](int n, const double* L, int ld, const int*, double* b) { dense::cholesky_solve_vector(n, L, ld, b); },
    [](int n, const double* L, int ld, const int*, double* b) { dense::cholesky_solve_vector(n, L, ld, b); }};

TEST(solutions) {
    Random random(3);
    for (int n = 1; n <= 30; ++n)
        for (const Solver* solver : {&lu, &best, &cholesky}) {
            const Matrix A = solver == &cholesky ? random.definite(n) : random.matrix(n, n), B = random.matrix(n, 7);
            const Eigen::PartialPivLU<Matrix> eigen(A);
            const double scale = 100.0 * n * n / eigen.rcond() * B.cwiseAbs().maxCoeff();
            Padded a(A), b(B);
            std::vector<int> pivot(n);
            const double regularity = solver->factor(n, a.data(), a.ld, pivot.data());
            check(regularity > 0.0, of_size(solver->name, n) + ": singular");
            if (solver == &lu) {
                const Vector pivots = eigen.matrixLU().diagonal().cwiseAbs();
                check_equal(regularity, pivots.minCoeff() / pivots.maxCoeff(), scale, of_size("pivots", n));
            }
            solver->solve(n, a.data(), a.ld, pivot.data(), b.data(), b.ld, b.ld);
            check_equal(b.matrix(), eigen.solve(B), scale, of_size(solver->name, n) + ": solve");
            Vector x = B.col(0), y = B.col(1);
            solver->solve_vector(n, a.data(), a.ld, pivot.data(), x.data());
            check_equal(x, eigen.solve(B.col(0)), scale, of_size(solver->name, n) + ": solve_vector");
            solver->solve_transposed(n, a.data(), a.ld, pivot.data(), y.data());
            check_equal(y, Eigen::PartialPivLU<Matrix>(A.transpose()).solve(B.col(1)), scale,
                        of_size(solver->name, n) + ": solve_transposed");
        }
}

TEST(singular_matrices) {
    Random random(4);
    for (int n = 2; n <= 20; ++n) {
        Matrix A = random.matrix(n, n), M = random.definite(n);
        A.row(n - 1).setZero();
        M(n / 2, n / 2) = -1.0;
        for (const double entry : {0.0, std::numeric_limits<double>::quiet_NaN()}) {
            A(n - 1, n - 1) = entry;
            for (const Solver* solver : {&lu, &best}) {
                Padded a(A);
                std::vector<int> pivot(n);
                check(solver->factor(n, a.data(), a.ld, pivot.data()) == 0.0, of_size(solver->name, n) + ": regular");
            }
        }
        Padded m(M);
        check(!dense::cholesky(n, m.data(), m.ld), of_size("cholesky", n) + ": definite");
    }
}

// L D L' of a matrix with `negative` entries of D below zero, and what is solved with it.
template <int N>
void check_ldl(Random& random, int negative) {
    const Matrix L = Matrix::Identity(N, N) +
                     Matrix(0.3 * random.matrix(N, N)).triangularView<Eigen::StrictlyLower>().toDenseMatrix();
    Vector D = random.vector(N).cwiseAbs().array() + 1.0;
    for (int i = 0; i < negative; ++i) D[(2 * i) % N] *= D[(2 * i) % N] > 0.0 ? -1.0 : 1.0;
    const Matrix A = L * D.asDiagonal() * L.transpose(), B = random.matrix(N, 9);
    const Eigen::PartialPivLU<Matrix> eigen(A);
    const double scale = 300.0 * N * N / eigen.rcond() * B.cwiseAbs().maxCoeff();
    const std::string what = of_size("ldl", N, negative);
    Padded a(A), b(B), X(N, 9), Y(N, 9), Z(N, 9), kept(N, N);
    dense::SmallLdl<N> ldl;
    check(ldl.factor(a.data(), a.ld), what + ": refused");
    check(ldl.negative() == (D.array() < 0.0).count(), what + ": inertia");
    const auto place = [&](int v) { return typename dense::SmallLdl<N>::Place{X.data() + 4 * v, X.ld}; };
    ldl.solve(b.data(), b.ld, place, Y.data(), Z.data(), Y.ld, Y.ld / 4);
    check_equal(X.matrix(), -eigen.solve(B), scale, what + ": X");
    check_equal(Matrix(L * Y.matrix()), B, scale, what + ": Y");
    check_equal(Matrix(D.asDiagonal() * Z.matrix()), Y.matrix(), scale, what + ": Z");
    ldl.keep(kept.data(), kept.ld);
    Vector x = B.col(0);
    dense::ldl_solve_vector<N>(kept.data(), kept.ld, x.data());
    check_equal(x, eigen.solve(B.col(0)), scale, what + ": vector");
    const int n = random.integer(1, 20), m = random.integer(1, 20);
    const Matrix P = random.matrix(N, m), Q = random.matrix(N, n), C = random.matrix(m, n);
    Padded p(P), q(Q), from(C), to(m, n);
    dense::subtract_tn<N>(m, n, p.data(), p.ld, q.data(), q.ld, from.data(), from.ld, to.data(), to.ld);
    check_equal(to.matrix(), C - P.transpose() * Q, 30.0 * N, of_size("subtract_tn", m, n, N));
    const Matrix W = random.vector(N).asDiagonal() * Q, R = random.matrix(n, n);
    Padded w(W), r(R), value(n, n);
    dense::subtract_symmetric<N>(n, w.data(), q.data(), q.ld, r.data(), r.ld, value.data(), value.ld);
    check_equal(value.matrix(), 0.5 * (R + R.transpose()) - W.transpose() * Q, 60.0 * N,
                of_size("subtract_symmetric", n, N));
}

TEST(small_ldl) {
    Random random(5);
    for (int trial = 0; trial < 20; ++trial)
        for (int n = 1; n <= 8; ++n)
            dense::for_few(n, [&](auto N) {
                if constexpr (N > 0)
                    for (const int negative : {0, N / 2, int(N)}) check_ldl<N>(random, negative);
            });
}

TEST(ldl_that_would_lose_digits_is_refused) {
    Padded zero(Matrix{{0.0, 1.0}, {1.0, 0.0}}), small(Matrix{{1e-9, 1.0}, {1.0, 0.0}}),
        none(Matrix{{std::numeric_limits<double>::quiet_NaN(), 1.0}, {1.0, 1.0}});
    for (Padded* A : {&zero, &small, &none}) {
        dense::SmallLdl<2> ldl;
        check(!ldl.factor(A->data(), A->ld), "ldl without a pivot of its own is taken");
    }
}

}  // namespace
}  // namespace mbocp::tests
