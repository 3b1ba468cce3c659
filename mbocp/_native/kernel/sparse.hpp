// Sparse blocks of a stage: rows over the nonzeros of a function's output, in whatever order the function writes them.
#pragma once

#include <vector>

#include "dense.hpp"
#include "stage_function.hpp"

namespace mbocp {

// Pattern by rows. `index` says where in the function's output a nonzero's value is, so that values need no scatter.
struct SparseRows {
    struct Entry {
        int row, column, index;
    };
    std::vector<int> start{0}, column, index;
    // For vectors all entries in one loop, as rows are too short for loops of their own; in an order in which
    // neighbours add to different places.
    std::vector<Entry> across, along;  // column by column, row by row

    int rows() const { return static_cast<int>(start.size()) - 1; }
    int nnz() const { return static_cast<int>(column.size()); }

    // Rows [row, row + rows) of the nonzeros whose column is in [first, first + columns), counted from `first`.
    static SparseRows block(const Pattern& p, int row, int rows, int first, int columns);
    // The same for columns in any place: place[j] is where column j goes, or -1.
    static SparseRows select(const Pattern& p, int row, int rows, const std::vector<int>& place);

    // y += a A x
    void times(const double* values, const double* x, double* y, double a = 1.0) const;
    // y += a A'x
    void transposed_times(const double* values, const double* x, double* y, double a = 1.0) const;
    // Y += a A X over the first `width` columns of row-major matrices, a multiple of the vector's width.
    void times_matrix(const double* values, const double* X, int ldx, int width, double* Y, int ldy,
                      double a = 1.0) const;
    // Y += a A
    void add_to(const double* values, double* Y, int ldy, double a = 1.0) const;
};

// Rows by small dense panels: up to three neighbouring rows with the same run of columns. That is how the Hessians of
// bodies look, and nothing of it needs an index for each entry.
class Panels {
public:
    bool empty() const { return panels_.empty(); }
    // A run of `count` values, the first at values[first]; runs come row by row.
    void append(int row, int column, int first, int count);
    // Groups runs of neighbouring rows, and panels of the same shape. To be called when all are there.
    void group();

    // y += A x + A'(x of the rows), as a symmetric matrix asks for whose half this is.
    void times_both(const double* values, const double* x, double* y) const;
    // Y += A X over the first `width` columns, as above.
    void times_matrix(const double* values, const double* X, int ldx, int width, double* Y, int ldy) const;
    // Y += A
    void add_to(const double* values, double* Y, int ldy) const;

private:
    struct Panel {
        int row, column, count, rows, first[3];
    };
    std::vector<Panel> panels_;
};

// A symmetric matrix H = L + L', L its lower triangle with half the diagonal. Values row by row, which is how a
// function writes the upper triangle, column by column.
class SymmetricRows {
public:
    explicit SymmetricRows(const Pattern& upper = Pattern());

    // The function's output becomes L's values.
    void halve_diagonal(double* values) const;
    // y += H x
    void times(const double* values, const double* x, double* y) const { all_.times_both(values, x, y); }
    // A block of L, rows and columns counted from its own first.
    Panels block(int row, int rows, int column, int columns) const;

private:
    std::vector<int> start_{0}, column_, diagonal_;
    Panels all_;
};

}  // namespace mbocp
