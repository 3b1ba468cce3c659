// Random sparse matrices as a function of a stage returns them: nonzeros column by column.
#pragma once

#include "../kernel/stage_function.hpp"
#include "checks.hpp"

namespace mbocp::tests {

struct Sparse {
    Pattern pattern;
    Matrix matrix;
    Numbers values;
};

// The nonzeros of a matrix.
inline Sparse sparse_of(const Matrix& matrix) {
    Sparse s{{int(matrix.rows()), int(matrix.cols()), {}, {}}, matrix, {}};
    for (int j = 0; j < matrix.cols(); ++j)
        for (int i = 0; i < matrix.rows(); ++i)
            if (matrix(i, j) != 0.0)
                s.pattern.row.push_back(i), s.pattern.column.push_back(j), s.values.push_back(matrix(i, j));
    s.values.resize(s.values.size() + dense::width);  // as far as vectors read
    return s;
}

inline Sparse random_sparse(Random& random, int rows, int columns, double density) {
    Matrix matrix = random.matrix(rows, columns);
    for (double& entry : matrix.reshaped())
        if (!random.is(density)) entry = 0.0;
    return sparse_of(matrix);
}

inline Sparse random_upper(Random& random, int n, double density) {
    return sparse_of(random_sparse(random, n, n, density).matrix.triangularView<Eigen::Upper>());
}

}  // namespace mbocp::tests
