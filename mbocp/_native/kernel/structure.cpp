#include "structure.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

// Notation: see structure.hpp. Matrices are row-major.

namespace mbocp {
using dense::padded;

namespace {

constexpr double dependent = 1e-13;  // pivot below which constraints count as dependent, relative to their entries

std::size_t product(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

// The column of the largest entry of a row, of those where the mask is one; its size in `largest`.
int largest_column(int width, const double* row, const double* mask, double& largest) {
    using dense::Vec;
    Vec size = {0.0, 0.0, 0.0, 0.0}, column = size, at = {0.0, 1.0, 2.0, 3.0};
    for (int c = 0; c < width; c += 4, at += 4.0) {
        const Vec v = dense::load(row + c) * dense::load(mask + c), of = v < 0.0 ? -v : v;
        const auto larger = of > size;
        size = larger ? of : size, column = larger ? at : column;
    }
    const double low = std::max(size[0], size[1]), high = std::max(size[2], size[3]);
    largest = std::max(low, high);
    const double left = size[0] == low ? column[0] : column[1], right = size[2] == high ? column[2] : column[3];
    return static_cast<int>(largest == low ? left : right);
}

// Rows of A, V vectors from column `first` on, minus factor times row i over its pivot in column j, which counts as one
// there and where the others count as zero. A factor of zero for row i itself.
template <int V>
void subtract_row(int rows, int width, int first, int i, int j, const double* factor, double* A) {
    using dense::Vec;
    Vec top[V], keep[V];
    for (int v = 0; v < V; ++v) {
        const Vec column = Vec{0.0, 1.0, 2.0, 3.0} + static_cast<double>(first + 4 * v);
        const auto is_pivot = column == static_cast<double>(j);
        const Vec one = {1.0, 1.0, 1.0, 1.0}, row = dense::load(A + i * width + first + 4 * v);
        keep[v] = is_pivot ? Vec{0.0, 0.0, 0.0, 0.0} : one, top[v] = factor[rows] * (is_pivot ? one : row);
    }
    double* at = A + first;
    for (int k = 0; k < rows; ++k, at += width)
        for (int v = 0; v < V; ++v) dense::store(at + 4 * v, dense::load(at + 4 * v) * keep[v] - factor[k] * top[v]);
    for (int v = 0; v < V; ++v) dense::store(A + i * width + first + 4 * v, top[v]);
}

// A (rows x width, a multiple of four) <- its inverse in the pivot columns and inverse times the rest in the others, by
// Gauss-Jordan: each row in turn pivots in its largest column of those where `mask` is one, and which it zeroes. The
// scaled rows have no entry above one in these columns. `factor` is work of rows + 1. Returns the smallest pivot.
double gauss_jordan(int rows, int width, double* A, double* mask, int* pivot, double* factor) {
    double smallest = INFINITY, size = 0.0;
    for (int i = 0; i < rows; ++i) {
        const int j = largest_column(width, A + i * width, mask, size);
        if (!(size > 0.0) || !std::isfinite(size)) return 0.0;
        smallest = std::min(smallest, size);
        pivot[i] = j, mask[j] = 0.0;
        for (int k = 0; k < rows; ++k) factor[k] = A[k * width + j];
        factor[rows] = 1.0 / factor[i], factor[i] = 0.0;
        dense::for_tiles(width / 4, [&](auto V, int c) { subtract_row<V()>(rows, width, c, i, j, factor, A); });
    }
    return smallest;
}

// Largest entry of some rows.
double largest_entry(const SparseRows& A, const double* values) {
    double largest[4] = {};
    for (int k = 0; k < A.nnz(); ++k) largest[k % 4] = std::max(largest[k % 4], std::abs(values[A.index[k]]));
    return std::max(std::max(largest[0], largest[1]), std::max(largest[2], largest[3]));
}

void gather(const double* v, const int* at, int count, double* out) {
    for (int i = 0; i < count; ++i) out[i] = v[at[i]];
}

}  // namespace

Structure::Structure(const Pattern& jacobian, int ndx, int num_algebraic, int num_controls,
                     const std::vector<GroupOfRows>& groups)
    : ny(num_algebraic), nu(num_controls) {
    for (int k = 0; k < jacobian.nnz(); ++k)  // the first kinematic row holds dt at v's first entry
        if (jacobian.row[k] == 0 && jacobian.column[k] > 0 && jacobian.column[k] < ndx) nq = jacobian.column[k];
    nr = ndx - 2 * nq, d = nq - ny;
    if (nq < 1 || nr < 0 || d < 1)
        throw std::invalid_argument("groups: a state of " + std::to_string(ndx) + " entries and " + std::to_string(ny) +
                                    " constraints have no structure to use");
    check_rows(jacobian);
    check_groups(groups);
    Jw = SparseRows::block(jacobian, 0, nw(), 0, nw());
    Js = SparseRows::block(jacobian, 0, nw(), nw(), ndx + nu);
    const auto momentum = [&](int first, int columns) { return SparseRows::block(jacobian, nq, nq, first, columns); };
    Mq_ = momentum(0, nq), Mv_ = momentum(nq, nq), Mx_ = momentum(0, ndx);
    Mq0_ = momentum(nw(), nq), Mv0_ = momentum(nw() + nq, nq), Mu_ = momentum(nw() + ndx, nu);
    Ms_ = momentum(nw(), ndx + nu);
    ru_ = SparseRows::block(jacobian, 2 * nq, nr, nw() + ndx, nu);
    make_groups(jacobian, groups);
}

void Structure::check_rows(const Pattern& jacobian) {
    const int nx = ndx(), before = nw();
    const auto refuse = [](const char* rows, int row) {
        throw std::invalid_argument(std::string("groups: ") + rows + " row " + std::to_string(row) +
                                    " does not have the structure of these steps");
    };
    kinematic_.assign(product(3, nq), -1);
    for (int k = 0; k < jacobian.nnz(); ++k) {
        const int i = jacobian.row[k], j = jacobian.column[k];
        if (i < nq) {
            const int which = j == i ? 0 : j == nq + i ? 1 : j == before + i ? 2 : -1;
            if (which < 0) refuse("kinematic", i);
            kinematic_[3 * i + which] = k;
        } else if (i < 2 * nq) {
            if ((j >= 2 * nq && j < nx) || (j >= before + 2 * nq && j < before + nx)) refuse("momentum", i - nq);
        } else if (i < nx) {
            if (j != i && j < before + nx) refuse("remembered control's", i - 2 * nq);
        } else if (j >= nq) {
            refuse("constraint", i - nx);
        }
    }
    for (std::size_t i = 0; i < kinematic_.size(); ++i)
        if (kinematic_[i] < 0) refuse("kinematic", static_cast<int>(i) / 3);
}

void Structure::check_groups(const std::vector<GroupOfRows>& groups) const {
    std::vector<int> rows(static_cast<std::size_t>(ny), 0);
    for (const GroupOfRows& g : groups) {
        if (g.first < 0 || g.rows < 0 || g.first + g.rows > ny)
            throw std::invalid_argument("groups: rows beyond the " + std::to_string(ny) + " constraints");
        for (int i = g.first; i < g.first + g.rows; ++i) ++rows[i];
        for (const int c : g.columns)
            if (c < 0 || c >= nq) throw std::invalid_argument("groups: there is no column " + std::to_string(c));
    }
    for (int i = 0; i < ny; ++i)
        if (rows[i] != 1)
            throw std::invalid_argument("groups: constraint " + std::to_string(i) + " has to be in one of them");
}

void Structure::make_groups(const Pattern& jacobian, const std::vector<GroupOfRows>& groups) {
    // A group has columns of its own as long as no group before it knows them; otherwise it closes a loop.
    std::vector<bool> touched(static_cast<std::size_t>(nq), false), owned = touched;
    for (std::size_t k = 0; k < groups.size(); ++k) {
        const GroupOfRows& given = groups[k];
        Group g;
        g.first = given.first, g.rows = given.rows, g.columns = given.columns;
        std::sort(g.columns.begin(), g.columns.end());
        g.closes_loop = g.columns.empty();
        for (const int c : g.columns) g.closes_loop = g.closes_loop || touched[c] || owned[c];
        g.others = SparseRows::block(jacobian, ndx() + g.first, g.rows, 0, nq);
        for (const int c : g.others.column) touched[c] = true;
        if (!g.closes_loop) {
            if (g.width() < g.rows)
                throw std::invalid_argument("groups: group " + std::to_string(k) + " has more rows than columns");
            std::vector<int> own(static_cast<std::size_t>(jacobian.columns), -1), others = own;
            for (int c = 0; c < nq; ++c) others[c] = c;
            for (int j = 0; j < g.width(); ++j)
                own[g.columns[j]] = j, others[g.columns[j]] = -1, owned[g.columns[j]] = true;
            g.own = SparseRows::select(jacobian, ndx() + g.first, g.rows, own);
            g.others = SparseRows::select(jacobian, ndx() + g.first, g.rows, others);
        } else {
            g.candidate.assign(static_cast<std::size_t>(nq), g.columns.empty());
            for (const int c : g.columns) g.candidate[c] = true;
        }
        groups_.push_back(g);
    }
    for (int c = 0; c < nq; ++c)
        if (!owned[c]) unowned_.push_back(c);
    most_free_ = static_cast<int>(unowned_.size());
    for (Group& g : groups_) {
        g.free_before = most_free_, g.inverse = inverse_size_, g.Z = Z_size_;
        inverse_size_ += product(g.rows, padded(g.rows));
        if (g.closes_loop)
            Z_size_ += product(nq, padded(g.rows));
        else
            most_free_ += g.width() - g.rows;
        most_rows_ = std::max(most_rows_, g.rows);
        most_candidates_ = std::max({most_candidates_, g.width(), most_free_});
    }
}

std::size_t Structure::num_doubles() const {
    return inverse_size_ + Z_size_ + product(nq, 2 * padded(d) + padded(2 * d)) + product(padded(d), padded(d));
}

std::size_t Structure::num_ints() const {
    return static_cast<std::size_t>(d + ny + most_free_ + most_candidates_ + most_rows_);
}

void Structure::place(StepFactor& f, double* doubles, int* ints) const {
    f.inverse = doubles;
    f.Z = f.inverse + inverse_size_;
    f.N = f.Z + Z_size_;
    f.KN = f.N + product(nq, padded(d));
    f.V = f.KN + product(nq, padded(d));
    f.D = f.V + product(nq, padded(2 * d));
    f.pivot = ints;
    f.column = f.pivot + d;
    f.free = f.column + ny;
    f.list = f.free + most_free_;
}

std::size_t Structure::work_size() const {
    const int rows = padded(most_rows_), free = padded(most_free_), pd = padded(d);
    const std::size_t factor = product(nq, free) + product(rows, padded(most_candidates_)) + product(2 * rows, free) +
                               padded(most_candidates_) + rows + 1;
    const std::size_t vector = product(4, padded(nq)) + product(2, pd) + 2 * rows;
    return std::max({factor, vector, product(2 * rows + pd + nq, pd)}) + 16;
}

double Structure::eliminate_own(const Group& g, const double* values, StepFactor& f, double* N, int* at,
                                double* work) const {
    const int rows = g.rows, lda = padded(g.width()), ldn = padded(most_free_), ldi = padded(rows);
    double* A = work;
    double* AN = A + product(rows, lda);
    double *mask = AN + product(2 * rows, ldn), *factor = mask + lda;
    int *candidate = f.list, *pivot = candidate + most_candidates_;
    dense::zero(A, rows * lda);
    for (int i = 0; i < rows; ++i)
        for (int k = g.own.start[i]; k < g.own.start[i + 1]; ++k) A[i * lda + g.own.column[k]] = values[g.own.index[k]];
    for (int j = 0; j < lda; ++j) mask[j] = j < g.width() ? 1.0 : 0.0;
    const double smallest = gauss_jordan(rows, lda, A, mask, pivot, factor);
    if (!(smallest > 0.0)) return 0.0;
    int count = 0;
    for (int j = 0; j < g.width(); ++j)
        if (mask[j] == 1.0) candidate[count++] = j;
    for (int e = 0; e < count; ++e) {
        const int column = g.columns[candidate[e]];
        at[g.free_before + e] = column;
        N[column * ldn + g.free_before + e] = 1.0;
    }
    double* inverse = f.inverse + g.inverse;
    dense::zero(inverse, rows * ldi);
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < rows; ++k) inverse[i * ldi + k] = A[i * lda + pivot[k]];
        f.column[g.first + i] = g.columns[pivot[i]];
    }
    dense::zero(AN, 2 * rows * ldn);
    g.others.times_matrix(values, N, ldn, ldn, AN, ldn);
    double* pivots = AN + product(rows, ldn);
    if (g.free_before) dense::gemm_nn(rows, g.free_before, rows, inverse, ldi, AN, ldn, pivots, ldn, -1.0);
    for (int i = 0; i < rows; ++i) {
        double* row = N + f.column[g.first + i] * ldn;
        dense::copy(pivots + i * ldn, row, ldn);
        for (int e = 0; e < count; ++e) row[g.free_before + e] -= A[i * lda + candidate[e]];
    }
    return smallest / std::max(largest_entry(g.own, values), largest_entry(g.others, values));
}

double Structure::eliminate_loop(const Group& g, const double* values, StepFactor& f, double* N, int* at,
                                 double* work) const {
    const int rows = g.rows, ld = padded(most_free_), ldi = padded(rows);
    double* A = work;
    double *mask = A + product(rows, ld), *factor = mask + ld;
    int* pivot = f.list;
    dense::zero(A, rows * ld);
    g.others.times_matrix(values, N, ld, ld, A, ld);
    dense::zero(mask, ld);
    for (int p = 0; p < g.free_before; ++p)
        if (at[p] >= 0 && g.candidate[at[p]]) mask[p] = 1.0;
    const double smallest = gauss_jordan(rows, ld, A, mask, pivot, factor);
    if (!(smallest > 0.0)) return 0.0;
    double *inverse = f.inverse + g.inverse, *Z = f.Z + g.Z;
    dense::zero(inverse, rows * ldi);
    dense::zero(Z, nq * ldi);
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < rows; ++k) inverse[i * ldi + k] = A[i * ld + pivot[k]];
        for (int c = 0; c < nq; ++c) Z[c * ldi + i] = N[c * ld + pivot[i]];
    }
    for (int i = 0; i < rows; ++i) {
        for (int k = 0; k < rows; ++k) A[k * ld + pivot[i]] = 0.0;
        for (int c = 0; c < nq; ++c) N[c * ld + pivot[i]] = 0.0;
        f.column[g.first + i] = at[pivot[i]];
        at[pivot[i]] = -1;
    }
    dense::gemm_nn(nq, ld, rows, Z, ldi, A, ld, N, ld, -1.0);
    return smallest / largest_entry(g.others, values);
}

double Structure::factor(const double* values, StepFactor& f, double* work) const {
    f.dt = values[kinematic_[1]];
    for (int i = 0; i < nq; ++i)
        if (values[kinematic_[3 * i]] != -1.0 || values[kinematic_[3 * i + 1]] != f.dt ||
            values[kinematic_[3 * i + 2]] != 1.0)
            throw std::invalid_argument("groups: kinematic row " + std::to_string(i) + " is not q_before + dt v - q");
    const int ld = padded(most_free_), pd = padded(d);
    const bool has_loops = most_free_ != d;
    double* N = has_loops ? work : f.N;
    double* rest = has_loops ? work + product(nq, ld) : work;
    int* at = f.free;
    dense::zero(N, nq * ld);
    for (std::size_t e = 0; e < unowned_.size(); ++e) at[e] = unowned_[e], N[unowned_[e] * ld + e] = 1.0;
    double smallest = 1.0;
    for (const Group& g : groups_) {
        const double pivot =
            g.closes_loop ? eliminate_loop(g, values, f, N, at, rest) : eliminate_own(g, values, f, N, at, rest);
        if (g.rows) smallest = std::min(smallest, pivot);
        if (g.rows && !(pivot > dependent)) return 0.0;
    }
    if (has_loops) {
        dense::zero(f.N, nq * pd);
        int free = 0;
        for (int p = 0; p < most_free_; ++p) {
            if (at[p] < 0) continue;
            for (int c = 0; c < nq; ++c) f.N[c * pd + free] = N[c * ld + p];
            at[free++] = at[p];
        }
    }
    dense::zero(f.KN, nq * pd);
    Mq_.times_matrix(values, f.N, pd, pd, f.KN, pd, f.dt);
    Mv_.times_matrix(values, f.N, pd, pd, f.KN, pd);
    dense::zero(f.D, pd * pd);
    dense::gemm_tn(d, d, nq, f.N, pd, f.KN, pd, f.D, pd);
    return std::min(smallest, dense::lu_factor(d, f.D, pd, f.pivot));
}

void Structure::particular_matrix(const double* values, const StepFactor& f, const double* C, double* X,
                                  double* work) const {
    const int ld = padded(d);
    double *t = work, *s = t + product(padded(most_rows_), ld);
    dense::zero(X, nq * ld);
    for (const Group& g : groups_) {
        const int ldi = padded(g.rows);
        dense::copy(C + g.first * ld, t, g.rows * ld);
        g.others.times_matrix(values, X, ld, ld, t, ld, -1.0);
        dense::zero(s, g.rows * ld);
        dense::gemm_nn(g.rows, ld, g.rows, f.inverse + g.inverse, ldi, t, ld, s, ld);
        if (g.closes_loop)
            dense::gemm_nn(nq, ld, g.rows, f.Z + g.Z, ldi, s, ld, X, ld);
        else
            for (int i = 0; i < g.rows; ++i) dense::copy(s + i * ld, X + f.column[g.first + i] * ld, ld);
    }
}

void Structure::particular(const double* values, const StepFactor& f, const double* c, double* dq, double* work) const {
    double *t = work, *s = t + padded(most_rows_);
    dense::zero(dq, nq);
    for (const Group& g : groups_) {
        const int ldi = padded(g.rows);
        dense::zero(t, ldi), dense::zero(s, ldi);
        dense::copy(c + g.first, t, g.rows);
        g.others.times(values, dq, t, -1.0);
        dense::gemv(g.rows, ldi, f.inverse + g.inverse, ldi, t, s);
        if (g.closes_loop)
            dense::gemv(nq, ldi, f.Z + g.Z, ldi, s, dq);
        else
            for (int i = 0; i < g.rows; ++i) dq[f.column[g.first + i]] = s[i];
    }
}

void Structure::multipliers(const double* values, const StepFactor& f, double* r, double* y, double* work) const {
    double *t = work, *s = t + padded(most_rows_);
    for (auto at = groups_.rbegin(); at != groups_.rend(); ++at) {
        const Group& g = *at;
        const int ldi = padded(g.rows);
        dense::zero(t, ldi), dense::zero(s, ldi);
        if (g.closes_loop)
            dense::gemv_t(nq, ldi, f.Z + g.Z, ldi, r, t);
        else
            gather(r, f.column + g.first, g.rows, t);
        dense::gemv_t(g.rows, ldi, f.inverse + g.inverse, ldi, t, s);
        dense::copy(s, y + g.first, g.rows);
        g.others.transposed_times(values, s, r, -1.0);
    }
}

void Structure::solve_vector(const double* values, const StepFactor& f, double* b, double* work) const {
    const int pd = padded(d);
    double *base = work, *along = base + nq, *left = along + nq, *beta = left + nq, *rest = beta + pd;
    double *kinematic = b, *momentum = b + nq, *y = b + ndx();
    particular(values, f, y, base, rest);
    // dq = base + dt N beta, dv = (ck + base) / dt + N beta
    for (int i = 0; i < nq; ++i) kinematic[i] = (kinematic[i] + base[i]) / f.dt;
    Mq_.times(values, base, momentum, -1.0);
    Mv_.times(values, kinematic, momentum, -1.0);
    dense::zero(beta, pd), dense::zero(along, nq), dense::zero(left, nq);
    dense::gemv_t(nq, pd, f.N, pd, momentum, beta);
    dense::lu_solve_vector(d, f.D, pd, f.pivot, beta);
    dense::gemv(nq, pd, f.N, pd, beta, along);
    dense::gemv(nq, pd, f.KN, pd, beta, left);
    for (int i = 0; i < nq; ++i) left[i] = (left[i] - momentum[i]) / f.dt;  // dt Gd'y
    multipliers(values, f, left, y, rest);
    for (int i = 0; i < nq; ++i) {
        momentum[i] = kinematic[i] + along[i];
        kinematic[i] = base[i] + f.dt * along[i];
    }
    for (int i = 2 * nq; i < ndx(); ++i) b[i] = -b[i];
}

void Structure::balance(const double* values, const StepFactor& f, const double* x, const double* s, const double* cm,
                        double* y, double* work) const {
    dense::copy(cm, work, nq);
    Mx_.times(values, x, work);
    Ms_.times(values, s, work);
    for (int i = 0; i < nq; ++i) work[i] /= f.dt;
    multipliers(values, f, work, y, work + nq);
}

void Structure::momentum_multipliers(const double* values, const StepFactor& f, const double* along, const double* by,
                                     double* mm, double* work) const {
    const int pd = padded(d);
    double* mu = work;
    particular(values, f, by, mm, work + pd);
    for (int i = 0; i < nq; ++i) mm[i] *= -1.0 / f.dt;
    dense::zero(mu, pd);
    dense::copy(along, mu, d);
    dense::gemv_t(nq, pd, f.KN, pd, mm, mu, -1.0);
    dense::lu_solve_transposed(d, f.D, pd, f.pivot, mu);
    dense::gemv(nq, pd, f.N, pd, mu, mm);
}

void Structure::other_multipliers(const double* values, const StepFactor& f, double* b, const double* mm,
                                  double* work) const {
    double *bq = b, *bv = b + nq, *rate = work;  // rate: of the v rows, what the kinematic multipliers make up for
    double *left = rate + nq, *rest = left + nq;
    dense::copy(bv, rate, nq);
    Mv_.transposed_times(values, mm, rate, -1.0);
    for (int i = 0; i < nq; ++i) rate[i] /= f.dt, left[i] = bq[i] + rate[i];
    Mq_.transposed_times(values, mm, left, -1.0);
    multipliers(values, f, left, b + ndx(), rest);
    dense::copy(rate, bq, nq);
    dense::copy(mm, bv, nq);
    for (int i = 2 * nq; i < ndx(); ++i) b[i] = -b[i];
}

void Structure::solve_transposed(const double* values, const StepFactor& f, double* b, double* work) const {
    const int pd = padded(d);
    double *along = work, *mm = along + pd, *sum = mm + nq, *rest = sum + nq;
    for (int i = 0; i < nq; ++i) sum[i] = f.dt * b[i] + b[nq + i];
    dense::zero(along, pd);
    dense::gemv_t(nq, pd, f.N, pd, sum, along);
    momentum_multipliers(values, f, along, b + ndx(), mm, rest);
    other_multipliers(values, f, b, mm, rest);
}

// V = ((N - N_before C) / dt, N_before), C = N[E_before]
void Structure::reach(StepFactor& f, const StepFactor* before, double* work) const {
    const int pd = padded(d), pb = padded(2 * d);
    const StepFactor& of = before ? *before : f;
    double *C = work, *NC = C + product(pd, pd);
    if (before) {
        for (int j = 0; j < d; ++j) dense::copy(f.N + before->free[j] * pd, C + j * pd, pd);
        dense::copy(f.N, NC, nq * pd);
        dense::gemm_nn(nq, d, d, before->N, pd, C, pd, NC, pd, -1.0);
    } else {
        dense::zero(NC, nq * pd);
    }
    const double rate = 1.0 / f.dt;
    dense::zero(f.V, nq * pb);
    for (int i = 0; i < nq; ++i)
        for (int j = 0; j < d; ++j) {
            f.V[i * pb + j] = rate * NC[i * pd + j];
            f.V[i * pb + d + j] = of.N[i * pd + j];
        }
}

void Structure::basis(const StepFactor& f, double* B) const {
    const int px = padded(nd());
    for (int i = 0; i < nq; ++i) {
        dense::copy(f.N + i * padded(d), B + i * px, d);
        dense::copy(f.V + i * padded(2 * d), B + (nq + i) * px, 2 * d);
    }
    for (int j = 2 * d; j < nd(); ++j) B[(2 * nq + j - 2 * d) * px + j] = 1.0;
}

void Structure::expand(const StepFactor& f, const double* xi, double* dx, double scale) const {
    const int pd = padded(d), pb = padded(2 * d);
    dense::gemv(nq, pd, f.N, pd, xi, dx, scale);
    dense::gemv(nq, pb, f.V, pb, xi, dx + nq, scale);
    for (int j = 0; j < nr; ++j) dx[2 * nq + j] += scale * xi[2 * d + j];
}

void Structure::project(const StepFactor& f, const double* h, double* g) const {
    const int pd = padded(d), pb = padded(2 * d);
    dense::gemv_t(nq, pd, f.N, pd, h, g);
    dense::gemv_t(nq, pb, f.V, pb, h + nq, g);
    for (int j = 0; j < nr; ++j) g[2 * d + j] += h[2 * nq + j];
}

void Structure::times_basis(const OverState& L, const double* values, const StepFactor& f, double* Y) const {
    const int pd = padded(d), pb = padded(2 * d), px = padded(nd());
    L.q.times_matrix(values, f.N, pd, pd, Y, px);
    L.v.times_matrix(values, f.V, pb, pb, Y, px);
    L.r.add_to(values, Y + 2 * d, px);
}

void Structure::project_matrix(const StepFactor& f, const double* Y, double* M, int ldm) const {
    const int px = padded(nd());
    dense::gemm_tn(d, nd(), nq, f.N, padded(d), Y, px, M, ldm);
    dense::gemm_tn(2 * d, nd(), nq, f.V, padded(2 * d), Y + product(nq, px), px, M, ldm);
    for (int j = 0; j < nr; ++j) dense::axpy(nd(), 1.0, Y + product(2 * nq + j, px), M + (2 * d + j) * ldm);
}

void Structure::gram(const StepFactor& f, double* M, int ldm) const {
    const int pd = padded(d), pb = padded(2 * d);
    dense::gemm_tn(d, d, nq, f.N, pd, f.N, pd, M, ldm);
    dense::gemm_tn(2 * d, 2 * d, nq, f.V, pb, f.V, pb, M, ldm);
    for (int j = 2 * d; j < nd(); ++j) M[j * ldm + j] += 1.0;
}

// With dv = (dq - dq_before) / dt and dq = dt N beta the momentum rows are KN beta - R - dt Gd'y.
void Structure::respond(const double* values, const StepFactor& f, const StepFactor* before, double* R, double* beta,
                        double* T, int ld, double* work) const {
    const int pd = padded(d), pb = padded(2 * d);
    const double rate = 1.0 / f.dt;
    dense::zero(R, nq * ld);
    if (before) {
        Mv_.times_matrix(values, before->N, pd, pd, R, ld, rate);
        Mq0_.times_matrix(values, before->N, pd, pd, R, ld, -1.0);
        Mv0_.times_matrix(values, before->V, pb, pb, R, ld, -1.0);
    }
    Mu_.add_to(values, R + nd(), ld, -1.0);
    dense::zero(beta, pd * ld);
    dense::gemm_tn(d, ld, nq, f.N, pd, R, ld, beta, ld);
    dense::lu_solve(d, f.D, pd, f.pivot, beta, ld, ld);
    dense::zero(T, nd() * ld);
    dense::axpy(d * ld, f.dt, beta, T);
    const StepFactor& of = before ? *before : f;
    double* C = work;
    for (int j = 0; j < d; ++j) dense::copy(f.N + of.free[j] * pd, C + j * pd, pd);
    dense::gemm_nn(d, ld, d, C, pd, beta, ld, T + d * ld, ld);
    for (int j = 0; before && j < d; ++j) T[(d + j) * ld + j] -= rate;
    ru_.add_to(values, T + 2 * d * ld + nd(), ld);
}

void Structure::respond_transposed(const double* values, const StepFactor& f, const double* mm, double* s) const {
    Ms_.transposed_times(values, mm, s, -1.0);
    Mv_.transposed_times(values, mm, s, 1.0 / f.dt);
}

}  // namespace mbocp
