// Sparse blocks of a stage: rows over the nonzeros of a function's output, in whatever order the function writes them.
#pragma once

#include <vector>

#include "dense.hpp"
#include "stage_function.hpp"

namespace mbocp {

// Pattern by rows. `index` says where in the function's output a nonzero's value is, so that values need no scatter.
struct SparseRows {
    std::vector<int> start{0}, column, index;

    int rows() const { return static_cast<int>(start.size()) - 1; }
    int nnz() const { return static_cast<int>(column.size()); }
    // One past the last row before `end` that has a value.
    int last_row(int end) const {
        while (end > 0 && start[end] == start[end - 1]) --end;
        return end;
    }

    // Rows [row, row + rows) of the nonzeros whose column is in [first, first + columns), counted from `first`.
    static SparseRows block(const Pattern& p, int row, int rows, int first, int columns);
    // The same for columns in any place: place[j] is where column j goes, or -1.
    static SparseRows select(const Pattern& p, int row, int rows, const std::vector<int>& place);

    // y += a A x
    void times(const double* values, const double* x, double* y, double a = 1.0) const;
    // y += a A'x
    void transposed_times(const double* values, const double* x, double* y, double a = 1.0) const;
    // Y += a A X, row-major with `ld` columns, a multiple of the vector's width.
    void times_matrix(const double* values, const double* X, int ld, double* Y, double a = 1.0) const;
    // Y += a A'X, likewise.
    void transposed_times_matrix(const double* values, const double* X, int ld, double* Y, double a = 1.0) const;
};

// A symmetric matrix H = U + U', U its upper triangle with half the diagonal; values row by row.
struct SymmetricRows {
    SparseRows half;  // U

    explicit SymmetricRows(const Pattern& upper = Pattern());

    // Values in this order from the function's output.
    void store(const double* output, double* values) const;
    // y += H x
    void times(const double* values, const double* x, double* y) const;
    // A block of U.
    SparseRows block(int row, int rows, int column, int columns) const;

private:
    struct Run {  // neighbours in a row
        int row, column, first, count;
    };
    std::vector<int> order_, diagonal_;
    std::vector<Run> runs_;
};

}  // namespace mbocp
