#include "structure.hpp"

#include <algorithm>
#include <stdexcept>
#include <string>

// Notation: see structure.hpp. Matrices with `ld` columns are row-major; a vector is one with a vector's width.

namespace mbocp {
using dense::padded;

namespace {

constexpr double dependent = 1e-13;  // pivot below which constraints count as dependent, relative to their entries

std::size_t product(int a, int b) { return static_cast<std::size_t>(a) * static_cast<std::size_t>(b); }

// Largest size in a row, of the columns where the mask is one.
inline double masked_largest(int width, const double* row, const double* mask) {
    dense::Vec largest = {0.0, 0.0, 0.0, 0.0};
    for (int c = 0; c < width; c += 4) {
        const dense::Vec v = dense::load(row + c) * dense::load(mask + c), size = v < 0.0 ? -v : v;
        largest = size > largest ? size : largest;
    }
    return std::max(std::max(largest[0], largest[1]), std::max(largest[2], largest[3]));
}

// row -= factor top; returns the largest of what is left where the mask is one.
inline double subtract_row(int width, double factor, const double* top, double* row, const double* mask) {
    dense::Vec largest = {0.0, 0.0, 0.0, 0.0};
    for (int c = 0; c < width; c += 4) {
        const dense::Vec v = dense::load(row + c) - factor * dense::load(top + c);
        const dense::Vec masked = v * dense::load(mask + c), size = masked < 0.0 ? -masked : masked;
        dense::store(row + c, v);
        largest = size > largest ? size : largest;
    }
    return std::max(std::max(largest[0], largest[1]), std::max(largest[2], largest[3]));
}

// A (rows x width, a multiple of four) <- its inverse in the pivot columns and inverse times
// the rest in the others, by Gauss-Jordan with complete pivoting among the columns where `mask` is one; it is zero in
// those that were taken afterwards. Row i's pivot is at pivot[i]. `size` is work. Returns the smallest pivot.
double gauss_jordan(int rows, int width, double* A, double* mask, int* pivot, double* size) {
    double smallest = INFINITY;
    for (int i = 0; i < rows; ++i) size[i] = masked_largest(width, A + i * width, mask), pivot[i] = -1;
    for (int count = 0; count < rows; ++count) {
        int i = -1;
        for (int k = 0; k < rows; ++k)
            if (pivot[k] < 0 && (i < 0 || size[k] > size[i])) i = k;
        double* top = A + i * width;
        int j = 0;
        while (j < width && !(std::abs(top[j]) * mask[j] == size[i])) ++j;
        if (!(size[i] > 0.0) || !std::isfinite(size[i]) || j == width) return 0.0;
        smallest = std::min(smallest, size[i]);
        pivot[i] = j, mask[j] = 0.0;
        const double inverse = 1.0 / top[j];
        top[j] = 1.0;
        for (int c = 0; c < width; ++c) top[c] *= inverse;
        for (int k = 0; k < rows; ++k) {
            double* row = A + k * width;
            const double factor = row[j];
            if (k == i) continue;
            row[j] = 0.0;
            size[k] = subtract_row(width, factor, top, row, mask);
        }
    }
    return smallest;
}

// Largest entry of some rows.
double largest_entry(const SparseRows& A, const double* values) {
    double largest = 0.0;
    for (const int k : A.index) largest = std::max(largest, std::abs(values[k]));
    return largest;
}

void gather_rows(const double* A, int ld, const int* rows, int count, double* B) {
    for (int i = 0; i < count; ++i) dense::copy(A + rows[i] * ld, B + i * ld, ld);
}

// A vector as the first column of a matrix with a whole vector's columns, and back.
void widen(const double* v, int n, double* M) {
    dense::zero(M, 4 * n);
    for (int i = 0; i < n; ++i) M[4 * i] = v[i];
}

void narrow(const double* M, int n, double* v) {
    for (int i = 0; i < n; ++i) v[i] = M[4 * i];
}

}  // namespace

Structure::Structure(const Pattern& jacobian, int ndx, int num_algebraic, int num_controls,
                     const std::vector<GroupOfRows>& groups)
    : ny(num_algebraic), nu(num_controls) {
    for (int k = 0; k < jacobian.nnz(); ++k)  // the first kinematic row holds dt at v's first entry
        if (jacobian.row[k] == 0 && jacobian.column[k] > 0 && jacobian.column[k] < ndx) nq = jacobian.column[k];
    nr = ndx - 2 * nq, d = nq - ny;
    if (nq < 1 || nr < 0 || d < 1)
        throw std::invalid_argument("groups: a state of " + std::to_string(ndx) + " entries and " +
                                    std::to_string(ny) + " constraints have no structure to use");
    check_rows(jacobian);
    check_groups(groups);
    Jw = SparseRows::block(jacobian, 0, nw(), 0, nw());
    Js = SparseRows::block(jacobian, 0, nw(), nw(), ndx + nu);
    Mq_ = SparseRows::block(jacobian, nq, nq, 0, nq);
    Mv_ = SparseRows::block(jacobian, nq, nq, nq, nq);
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
    return inverse_size_ + Z_size_ + 2 * product(nq, padded(d)) + product(padded(d), padded(d));
}

std::size_t Structure::num_ints() const {
    return static_cast<std::size_t>(d + ny + most_free_ + most_candidates_ + most_rows_);
}

void Structure::place(StepFactor& f, double* doubles, int* ints) const {
    f.inverse = doubles;
    f.Z = f.inverse + inverse_size_;
    f.N = f.Z + Z_size_;
    f.KN = f.N + product(nq, padded(d));
    f.D = f.KN + product(nq, padded(d));
    f.pivot = ints;
    f.column = f.pivot + d;
    f.free = f.column + ny;
    f.list = f.free + most_free_;
}

std::size_t Structure::solve_size(int ld) const {
    return product(2 * nq + padded(d) + 2 * padded(most_rows_), ld);
}

std::size_t Structure::work_size(int columns) const {
    const int rows = padded(most_rows_), free = padded(most_free_);
    const std::size_t factor = product(nq, free) + product(rows, padded(most_candidates_)) + product(2 * rows, free) +
                               padded(most_candidates_) + rows;
    const std::size_t vector = product(2 * nw(), 4) + product(4, nq) + product(2, padded(d)) + solve_size(4);
    return std::max({factor, vector, solve_size(padded(columns))}) + 16;
}

double Structure::eliminate_own(const Group& g, const double* values, StepFactor& f, double* N, int* at,
                                double* work) const {
    const int rows = g.rows, lda = padded(g.width()), ldn = padded(most_free_), ldi = padded(rows);
    double* A = work;
    double* AN = A + product(rows, lda);
    double *mask = AN + product(2 * rows, ldn), *size = mask + lda;
    int *candidate = f.list, *pivot = candidate + most_candidates_;
    dense::zero(A, rows * lda);
    for (int i = 0; i < rows; ++i)
        for (int k = g.own.start[i]; k < g.own.start[i + 1]; ++k)
            A[i * lda + g.own.column[k]] = values[g.own.index[k]];
    for (int j = 0; j < lda; ++j) mask[j] = j < g.width() ? 1.0 : 0.0;
    const double smallest = gauss_jordan(rows, lda, A, mask, pivot, size);
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
    g.others.times_matrix(values, N, ldn, AN);
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
    double *mask = A + product(rows, ld), *size = mask + ld;
    int* pivot = f.list;
    dense::zero(A, rows * ld);
    g.others.times_matrix(values, N, ld, A);
    dense::zero(mask, ld);
    for (int p = 0; p < g.free_before; ++p)
        if (at[p] >= 0 && g.candidate[at[p]]) mask[p] = 1.0;
    const double smallest = gauss_jordan(rows, ld, A, mask, pivot, size);
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
    Mq_.times_matrix(values, f.N, pd, f.KN, f.dt);
    Mv_.times_matrix(values, f.N, pd, f.KN);
    dense::zero(f.D, pd * pd);
    dense::gemm_tn(d, d, nq, f.N, pd, f.KN, pd, f.D, pd);
    return std::min(smallest, dense::lu_factor(d, f.D, pd, f.pivot));
}

void Structure::particular_matrix(const double* values, const StepFactor& f, const double* C, int ld, double* X,
                                  double* work) const {
    double *t = work, *s = t + product(padded(most_rows_), ld);
    dense::zero(X, nq * ld);
    for (const Group& g : groups_) {
        const int ldi = padded(g.rows);
        dense::copy(C + g.first * ld, t, g.rows * ld);
        g.others.times_matrix(values, X, ld, t, -1.0);
        dense::zero(s, g.rows * ld);
        dense::gemm_nn(g.rows, ld, g.rows, f.inverse + g.inverse, ldi, t, ld, s, ld);
        if (g.closes_loop)
            dense::gemm_nn(nq, ld, g.rows, f.Z + g.Z, ldi, s, ld, X, ld);
        else
            for (int i = 0; i < g.rows; ++i) dense::copy(s + i * ld, X + f.column[g.first + i] * ld, ld);
    }
}

void Structure::multipliers_matrix(const double* values, const StepFactor& f, double* R, int ld, double* Y,
                                   double* work) const {
    double *t = work, *s = t + product(padded(most_rows_), ld);
    for (auto at = groups_.rbegin(); at != groups_.rend(); ++at) {
        const Group& g = *at;
        const int ldi = padded(g.rows);
        if (g.closes_loop) {
            dense::zero(t, ldi * ld);
            dense::gemm_tn(g.rows, ld, nq, f.Z + g.Z, ldi, R, ld, t, ld);
        } else {
            gather_rows(R, ld, f.column + g.first, g.rows, t);
        }
        dense::zero(s, ldi * ld);
        dense::gemm_tn(g.rows, ld, g.rows, f.inverse + g.inverse, ldi, t, ld, s, ld);
        dense::copy(s, Y + g.first * ld, g.rows * ld);
        g.others.transposed_times_matrix(values, s, ld, R, -1.0);
    }
}

void Structure::solve(const double* values, const StepFactor& f, double* B, int ld, bool constraints,
                      double* work) const {
    const int pd = padded(d);
    double *base = work, *along = base + product(nq, ld), *beta = along + product(nq, ld);
    double *rest = beta + product(pd, ld);
    double *kinematic = B, *momentum = B + product(nq, ld), *remembered = B + product(2 * nq, ld);
    double* y = B + product(ndx(), ld);
    if (constraints)
        particular_matrix(values, f, y, ld, base, rest);
    else
        dense::zero(base, nq * ld);
    // dq = base + dt N beta, dv = (ck + base) / dt + N beta, with dq[E] = -ck[E] where beta is zero
    gather_rows(kinematic, ld, f.free, d, beta);
    dense::gemm_nn(nq, ld, d, f.N, pd, beta, ld, base, ld, -1.0);
    const double rate = 1.0 / f.dt;
    for (int i = 0; i < nq * ld; ++i) kinematic[i] = (kinematic[i] + base[i]) * rate;
    Mq_.times_matrix(values, base, ld, momentum, -1.0);
    Mv_.times_matrix(values, kinematic, ld, momentum, -1.0);
    dense::zero(beta, pd * ld);
    dense::gemm_tn(d, ld, nq, f.N, pd, momentum, ld, beta, ld);
    dense::lu_solve(d, f.D, pd, f.pivot, beta, ld, ld);
    dense::zero(along, nq * ld);
    dense::gemm_nn(nq, ld, d, f.N, pd, beta, ld, along, ld);
    dense::gemm_nn(nq, ld, d, f.KN, pd, beta, ld, momentum, ld, -1.0);
    for (int i = 0; i < nq * ld; ++i) momentum[i] *= -rate;  // -dt Gd' y = what is left
    multipliers_matrix(values, f, momentum, ld, y, rest);
    for (int i = 0; i < nq * ld; ++i) {
        momentum[i] = kinematic[i] + along[i];
        kinematic[i] = base[i] + f.dt * along[i];
    }
    for (int i = 0; i < nr * ld; ++i) remembered[i] = -remembered[i];
}

void Structure::solve_vector(const double* values, const StepFactor& f, double* b, double* work) const {
    double* B = work;
    widen(b, nw(), B);
    solve(values, f, B, 4, true, B + product(nw(), 4));
    narrow(B, nw(), b);
}

void Structure::particular(const double* values, const StepFactor& f, const double* c, double scale, double* dq,
                           double* work) const {
    double *C = work, *X = C + product(ny, 4), *rest = X + product(nq, 4);
    widen(c, ny, C);
    particular_matrix(values, f, C, 4, X, rest);
    for (int i = 0; i < nq; ++i) dq[i] = scale * X[4 * i];
}

void Structure::momentum_multipliers(const double* values, const StepFactor& f, const double* along,
                                     const double* by, double* mm, double* work) const {
    const int pd = padded(d);
    double* mu = work;
    particular(values, f, by, -1.0 / f.dt, mm, work + pd);
    dense::copy(along, mu, d);
    dense::gemv_t(nq, d, f.KN, pd, mm, mu, -1.0);
    dense::lu_solve_transposed(d, f.D, pd, f.pivot, mu);
    dense::gemv(nq, d, f.N, pd, mu, mm);
}

void Structure::other_multipliers(const double* values, const StepFactor& f, double* b, const double* mm,
                                  double* work) const {
    double *bq = b, *bv = b + nq, *rate = work;  // rate: of the v rows, what the kinematic multipliers make up for
    double *R = rate + nq, *Y = R + product(nq, 4), *rest = Y + product(ny, 4);
    dense::copy(bv, rate, nq);
    Mv_.transposed_times(values, mm, rate, -1.0);
    for (int i = 0; i < nq; ++i) rate[i] /= f.dt, bq[i] += rate[i];
    Mq_.transposed_times(values, mm, bq, -1.0);
    widen(bq, nq, R);
    multipliers_matrix(values, f, R, 4, Y, rest);
    narrow(Y, ny, b + ndx());
    dense::copy(rate, bq, nq);
    dense::copy(mm, bv, nq);
    for (int i = 2 * nq; i < ndx(); ++i) b[i] = -b[i];
}

void Structure::solve_transposed(const double* values, const StepFactor& f, double* b, double* work) const {
    const int pd = padded(d);
    double *along = work, *mm = along + pd, *sum = mm + nq, *rest = sum + nq;
    for (int i = 0; i < nq; ++i) sum[i] = f.dt * b[i] + b[nq + i];
    dense::zero(along, d);
    dense::gemv_t(nq, d, f.N, pd, sum, along);
    momentum_multipliers(values, f, along, b + ndx(), mm, rest);
    other_multipliers(values, f, b, mm, rest);
}

}  // namespace mbocp
