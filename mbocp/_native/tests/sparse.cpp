// Rows over nonzeros, panels and symmetric halves against the dense matrices that they stand for.
#include "../kernel/sparse.hpp"

#include "checks.hpp"
#include "patterns.hpp"

namespace mbocp::tests {
namespace {

TEST(sparse_rows) {
    Random random(11);
    for (int trial = 0; trial < 100; ++trial) {
        const int rows = random.integer(1, 12), columns = random.integer(1, 12), width = 4 * random.integer(1, 5);
        const Sparse sparse = random_sparse(random, rows, columns, 0.4);
        const int row = random.integer(0, rows - 1), m = random.integer(1, rows - row);
        const int first = random.integer(0, columns - 1), n = random.integer(1, columns - first);
        std::vector<int> place(columns, -1);
        for (int j = 0; j < columns; ++j)
            if (j >= first && j < first + n) place[j] = n - 1 - (j - first);
        const Matrix block = sparse.matrix.block(row, first, m, n);
        for (const bool is_turned : {false, true}) {
            const Matrix A = is_turned ? Matrix(block.rowwise().reverse()) : block;
            const SparseRows s = is_turned ? SparseRows::select(sparse.pattern, row, m, place)
                                           : SparseRows::block(sparse.pattern, row, m, first, n);
            check(s.rows() == m && s.nnz() == (A.array() != 0.0).count(), "nonzeros");
            const double *values = sparse.values.data(), scale = 60.0 * (m + n);
            const Vector x = random.vector(n), y = random.vector(m);
            Vector Ax = y, Aty = x;
            s.times(values, x.data(), Ax.data(), -0.3);
            check_equal(Ax, y - 0.3 * A * x, scale, "times");
            s.transposed_times(values, y.data(), Aty.data(), -0.3);
            check_equal(Aty, x - 0.3 * A.transpose() * y, scale, "transposed_times");
            const Matrix X = random.matrix(n, width), Y = random.matrix(m, width), C = random.matrix(m, n);
            Padded sum(Y), all(C);
            s.times_matrix(values, X.data(), width, width, sum.data(), sum.ld, -0.3);
            check_equal(sum.matrix(), Y - 0.3 * A * X, scale, "times_matrix");
            s.add_to(values, all.data(), all.ld, -0.3);
            check_equal(all.matrix(), C - 0.3 * A, scale, "add_to");
        }
    }
}

TEST(symmetric_rows) {
    Random random(12);
    for (int trial = 0; trial < 100; ++trial) {
        const int n = random.integer(1, 14), width = 4 * random.integer(1, 5);
        Sparse upper = random_upper(random, n, trial % 2 ? 0.3 : 0.9);  // the latter: runs of neighbours, as panels
        const Matrix H = upper.matrix.selfadjointView<Eigen::Upper>();
        const SymmetricRows rows(upper.pattern);
        rows.halve_diagonal(upper.values.data());
        const double *values = upper.values.data(), scale = 60.0 * n;
        const Vector x = random.vector(n), y = random.vector(n);
        Vector Hx = y;
        rows.times(values, x.data(), Hx.data());
        check_equal(Hx, y + H * x, scale, "symmetric times");
        const int row = random.integer(0, n - 1), m = random.integer(1, n - row);
        const int column = random.integer(0, n - 1), k = random.integer(1, n - column);
        Matrix half = H.triangularView<Eigen::Lower>();
        half.diagonal() *= 0.5;
        const Matrix L = half.block(row, column, m, k);
        const Panels panels = rows.block(row, m, column, k);
        check(panels.empty() == L.isZero(0.0), "empty panels");
        const Matrix X = random.matrix(k, width), Y = random.matrix(m, width), C = random.matrix(m, k);
        Padded sum(Y), all(C);
        panels.times_matrix(values, X.data(), width, width, sum.data(), sum.ld);
        check_equal(sum.matrix(), Y + L * X, scale, "panels times_matrix");
        panels.add_to(values, all.data(), all.ld);
        check_equal(all.matrix(), C + L, scale, "panels add_to");
    }
}

}  // namespace
}  // namespace mbocp::tests
