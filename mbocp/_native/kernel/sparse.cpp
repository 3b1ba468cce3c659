#include "sparse.hpp"

namespace mbocp {

namespace {

// Rows of nonzeros given as (row, column, index), ordered by rows and columns.
SparseRows by_rows(int rows, const std::vector<int>& row, const std::vector<int>& column,
                   const std::vector<int>& index) {
    SparseRows s;
    s.start.assign(static_cast<std::size_t>(rows) + 1, 0);
    for (const int i : row) ++s.start[i + 1];
    for (int i = 0; i < rows; ++i) s.start[i + 1] += s.start[i];
    s.column.resize(row.size()), s.index.resize(row.size());
    std::vector<int> next(s.start.begin(), s.start.end() - 1);
    for (std::size_t k = 0; k < row.size(); ++k) {
        const int at = next[row[k]]++;
        s.column[at] = column[k], s.index[at] = index[k];
    }
    return s;
}

// One row of Y += a A X over V vectors, which stay in registers.
template <int V>
inline void add_row(int count, const int* column, const int* index, const double* values, const double* X, int ld,
                    double* y, double a) {
    using dense::Vec;
    Vec sum[V];
    for (int v = 0; v < V; ++v) sum[v] = Vec{0.0, 0.0, 0.0, 0.0};
    for (int k = 0; k < count; ++k) {
        const double value = values[index[k]];
        const double* x = X + column[k] * ld;
        for (int v = 0; v < V; ++v) sum[v] += value * dense::load(x + 4 * v);
    }
    for (int v = 0; v < V; ++v) dense::store(y + 4 * v, dense::load(y + 4 * v) + a * sum[v]);
}

}  // namespace

SparseRows SparseRows::block(const Pattern& p, int row, int rows, int first, int columns) {
    std::vector<int> place(static_cast<std::size_t>(p.columns), -1);
    for (int j = 0; j < columns; ++j) place[first + j] = j;
    return select(p, row, rows, place);
}

SparseRows SparseRows::select(const Pattern& p, int row, int rows, const std::vector<int>& place) {
    std::vector<int> r, c, index;
    for (int k = 0; k < p.nnz(); ++k) {
        const int i = p.row[k] - row, j = place[p.column[k]];
        if (i >= 0 && i < rows && j >= 0) r.push_back(i), c.push_back(j), index.push_back(k);
    }
    return by_rows(rows, r, c, index);
}

void SparseRows::times(const double* values, const double* x, double* y, double a) const {
    for (int i = 0; i < rows(); ++i) {
        double sum = 0;
        for (int k = start[i]; k < start[i + 1]; ++k) sum += values[index[k]] * x[column[k]];
        y[i] += a * sum;
    }
}

void SparseRows::transposed_times(const double* values, const double* x, double* y, double a) const {
    for (int i = 0; i < rows(); ++i) {
        const double scaled = a * x[i];
        for (int k = start[i]; k < start[i + 1]; ++k) y[column[k]] += values[index[k]] * scaled;
    }
}

void SparseRows::times_matrix(const double* values, const double* X, int ld, double* Y, double a) const {
    for (int i = 0; i < rows(); ++i) {
        const int count = start[i + 1] - start[i];
        if (count == 0) continue;
        const int *c = column.data() + start[i], *at = index.data() + start[i];
        double* y = Y + i * ld;
        int j = 0;
        for (; j + 24 <= ld; j += 24) add_row<6>(count, c, at, values, X + j, ld, y + j, a);
        switch ((ld - j) / 4) {
            case 1: add_row<1>(count, c, at, values, X + j, ld, y + j, a); break;
            case 2: add_row<2>(count, c, at, values, X + j, ld, y + j, a); break;
            case 3: add_row<3>(count, c, at, values, X + j, ld, y + j, a); break;
            case 4: add_row<4>(count, c, at, values, X + j, ld, y + j, a); break;
            case 5: add_row<5>(count, c, at, values, X + j, ld, y + j, a); break;
            default: break;
        }
    }
}

void SparseRows::transposed_times_matrix(const double* values, const double* X, int ld, double* Y, double a) const {
    for (int i = 0; i < rows(); ++i)
        for (int k = start[i]; k < start[i + 1]; ++k)
            dense::axpy(ld, a * values[index[k]], X + i * ld, Y + column[k] * ld);
}

SymmetricRows::SymmetricRows(const Pattern& upper) {
    std::vector<int> index(upper.row.size());
    for (std::size_t k = 0; k < index.size(); ++k) index[k] = static_cast<int>(k);
    half = by_rows(upper.rows, upper.row, upper.column, index);
    order_ = half.index;
    for (int i = 0; i < half.rows(); ++i)
        for (int k = half.start[i]; k < half.start[i + 1]; ++k) {
            half.index[k] = k;
            if (half.column[k] == i) diagonal_.push_back(k);
            const bool continues = k > half.start[i] && half.column[k] == half.column[k - 1] + 1;
            if (continues)
                ++runs_.back().count;
            else
                runs_.push_back({i, half.column[k], k, 1});
        }
}

void SymmetricRows::store(const double* output, double* values) const {
    for (std::size_t k = 0; k < order_.size(); ++k) values[k] = output[order_[k]];
    for (const int k : diagonal_) values[k] *= 0.5;
}

void SymmetricRows::times(const double* values, const double* x, double* y) const {
    for (const Run& r : runs_) {
        const double sum = dense::dot(r.count, values + r.first, x + r.column);
        dense::axpy(r.count, x[r.row], values + r.first, y + r.column);
        y[r.row] += sum;
    }
}

SparseRows SymmetricRows::block(int row, int rows, int column, int columns) const {
    std::vector<int> r, c, index;
    for (int i = row; i < row + rows; ++i)
        for (int k = half.start[i]; k < half.start[i + 1]; ++k) {
            const int j = half.column[k] - column;
            if (j >= 0 && j < columns) r.push_back(i - row), c.push_back(j), index.push_back(k);
        }
    return by_rows(rows, r, c, index);
}

}  // namespace mbocp
