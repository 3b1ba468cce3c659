#include "sparse.hpp"

#include <algorithm>

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
    for (int i = 0; i < rows; ++i)
        for (int k = s.start[i]; k < s.start[i + 1]; ++k) s.along.push_back({i, s.column[k], s.index[k]});
    s.across = s.along;
    std::stable_sort(s.across.begin(), s.across.end(),
                     [](const SparseRows::Entry& a, const SparseRows::Entry& b) { return a.column < b.column; });
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
    for (const Entry& e : across) y[e.row] += values[e.index] * (a * x[e.column]);
}

void SparseRows::transposed_times(const double* values, const double* x, double* y, double a) const {
    for (const Entry& e : along) y[e.column] += values[e.index] * (a * x[e.row]);
}

void SparseRows::times_matrix(const double* values, const double* X, int ldx, int width, double* Y, int ldy,
                              double a) const {
    dense::for_tiles(width / 4, [&](auto V, int j) {
        for (int i = 0; i < rows(); ++i) {
            const int first = start[i], count = start[i + 1] - first;
            if (count) add_row<V()>(count, &column[first], &index[first], values, X + j, ldx, Y + i * ldy + j, a);
        }
    });
}

void SparseRows::add_to(const double* values, double* Y, int ldy, double a) const {
    for (int i = 0; i < rows(); ++i)
        for (int k = start[i]; k < start[i + 1]; ++k) Y[i * ldy + column[k]] += a * values[index[k]];
}

void Panels::append(int row, int column, int first, int count) {
    panels_.push_back({row, column, count, 1, {first, 0, 0}});
}

void Panels::group() {
    std::vector<Panel> grouped;
    std::vector<bool> taken(panels_.size(), false);
    for (std::size_t k = 0; k < panels_.size(); ++k) {
        if (taken[k]) continue;
        Panel p = panels_[k];
        for (std::size_t other = k + 1; other < panels_.size() && p.rows < 3; ++other) {
            const Panel& o = panels_[other];
            if (o.row > p.row + p.rows) break;
            if (o.row < p.row + p.rows || o.column != p.column || o.count != p.count) continue;
            p.first[p.rows++] = o.first[0], taken[other] = true;
        }
        grouped.push_back(p);
    }
    std::stable_sort(grouped.begin(), grouped.end(), [](const Panel& a, const Panel& b) {
        return a.rows != b.rows ? a.rows > b.rows : a.count > b.count;
    });
    panels_.swap(grouped);
}

namespace {

// R rows of a run: y[columns] += A'x[rows] and y[rows] += A x[columns].
template <int R>
inline void panel_times_both(int count, const double* const* values, const double* xc, const double* xr, double* yc,
                             double* yr) {
    using dense::Vec;
    Vec lanes[R] = {};
    double f[R], sum[R];
    for (int r = 0; r < R; ++r) f[r] = xr[r];
    int j = 0;
    for (; j + 4 <= count; j += 4) {
        const Vec x = dense::load(xc + j);
        Vec y = dense::load(yc + j);
        for (int r = 0; r < R; ++r) {
            const Vec v = dense::load(values[r] + j);
            lanes[r] += v * x, y += f[r] * v;
        }
        dense::store(yc + j, y);
    }
    for (int r = 0; r < R; ++r) sum[r] = (lanes[r][0] + lanes[r][1]) + (lanes[r][2] + lanes[r][3]);
    for (; j < count; ++j) {
        double y = yc[j];
        for (int r = 0; r < R; ++r) sum[r] += values[r][j] * xc[j], y += f[r] * values[r][j];
        yc[j] = y;
    }
    for (int r = 0; r < R; ++r) yr[r] += sum[r];
}

// R rows of a run times V vectors of columns.
template <int R, int V>
inline void panel_times_matrix(int count, const double* const* values, const double* X, int ldx, double* Y, int ldy) {
    using dense::Vec;
    Vec sum[R][V];
    for (int r = 0; r < R; ++r)
        for (int v = 0; v < V; ++v) sum[r][v] = dense::load(Y + r * ldy + 4 * v);
    for (int k = 0; k < count; ++k)
        for (int r = 0; r < R; ++r)
            for (int v = 0; v < V; ++v) sum[r][v] += values[r][k] * dense::load(X + k * ldx + 4 * v);
    for (int r = 0; r < R; ++r)
        for (int v = 0; v < V; ++v) dense::store(Y + r * ldy + 4 * v, sum[r][v]);
}

// call(std::integral_constant) with the number of rows of a panel, one to three.
template <class Call>
inline void for_rows(int rows, Call call) {
    if (rows == 3)
        call(std::integral_constant<int, 3>());
    else if (rows == 2)
        call(std::integral_constant<int, 2>());
    else
        call(std::integral_constant<int, 1>());
}

}  // namespace

void Panels::times_both(const double* values, const double* x, double* y) const {
    for (const Panel& p : panels_) {
        const double* rows[] = {values + p.first[0], values + p.first[1], values + p.first[2]};
        for_rows(p.rows, [&](auto R) {
            panel_times_both<R()>(p.count, rows, x + p.column, x + p.row, y + p.column, y + p.row);
        });
    }
}

void Panels::times_matrix(const double* values, const double* X, int ldx, int width, double* Y, int ldy) const {
    dense::for_tiles(width / 4, [&](auto V, int j) {
        for (const Panel& p : panels_) {
            const double* rows[] = {values + p.first[0], values + p.first[1], values + p.first[2]};
            for_rows(p.rows, [&](auto R) {
                panel_times_matrix<R(), V()>(p.count, rows, X + p.column * ldx + j, ldx, Y + p.row * ldy + j, ldy);
            });
        }
    });
}

void Panels::add_to(const double* values, double* Y, int ldy) const {
    for (const Panel& p : panels_)
        for (int r = 0; r < p.rows; ++r)
            for (int k = 0; k < p.count; ++k) Y[(p.row + r) * ldy + p.column + k] += values[p.first[r] + k];
}

SymmetricRows::SymmetricRows(const Pattern& upper) {
    const int n = upper.columns;
    for (int i = 0, k = 0; i < n; ++i) {
        for (; k < upper.nnz() && upper.column[k] == i; ++k) {
            if (upper.row[k] == i) diagonal_.push_back(k);
            column_.push_back(upper.row[k]);
        }
        start_.push_back(k);
    }
    all_ = block(0, n, 0, n);
}

void SymmetricRows::halve_diagonal(double* values) const {
    for (const int k : diagonal_) values[k] *= 0.5;
}

Panels SymmetricRows::block(int row, int rows, int column, int columns) const {
    Panels out;
    for (int i = row; i < row + rows; ++i)
        for (int k = start_[i]; k < start_[i + 1];) {
            const int first = k, j = column_[k] - column;
            while (++k < start_[i + 1] && column_[k] == column_[k - 1] + 1 && column_[k] != column + columns &&
                   column_[k] != column) {
            }
            if (j >= 0 && j < columns) out.append(i - row, j, first, k - first);
        }
    out.group();
    return out;
}

}  // namespace mbocp
