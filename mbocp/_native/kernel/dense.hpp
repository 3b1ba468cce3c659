// Small dense linear algebra for the stages: row-major, leading dimensions padded to whole vectors, no allocation.
//
// Blocks of a stage are 4 to 100 rows; at that size a general BLAS or a dynamic Eigen product spends more time
// in dispatch than in arithmetic. Padding columns hold zeros, so the kernels need no remainder loops.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstring>
#include <type_traits>

namespace mbocp::dense {

inline constexpr int width = 4;  // doubles in a vector register (AVX2); SSE2 code uses two registers for one
inline int padded(int n) { return (n + width - 1) / width * width; }

typedef double Vec __attribute__((vector_size(32), aligned(8), may_alias));
typedef long long Indices __attribute__((vector_size(32)));

inline Vec load(const double* p) { return *reinterpret_cast<const Vec*>(p); }
inline void store(double* p, Vec v) { *reinterpret_cast<Vec*>(p) = v; }

// The first n entries, at most as many as a vector has, and zeros.
inline Vec load_first(const double* p, int n) {
    const long long size = n;
    return Indices{0, 1, 2, 3} < Indices{size, size, size, size} ? load(p) : Vec{0.0, 0.0, 0.0, 0.0};
}

// The same where nothing behind them may be read, and where they may just have been stored one by one: the processor
// waits for these before it loads them as a vector.
inline Vec first_of(const double* p, int n) {
    if (n >= width) return load(p);
    return Vec{n > 0 ? p[0] : 0.0, n > 1 ? p[1] : 0.0, n > 2 ? p[2] : 0.0, 0.0};
}

inline void store_first(double* p, Vec v, int n) {
    if (n >= width) return store(p, v);
    if (n > 0) p[0] = v[0];
    if (n > 1) p[1] = v[1];
    if (n > 2) p[2] = v[2];
}

inline double sum_of(Vec v) { return (v[0] + v[1]) + (v[2] + v[3]); }
inline double largest_of(Vec v) { return std::max(std::max(v[0], v[1]), std::max(v[2], v[3])); }

// Rows of a stage's matrices are short: a call costs more than they do.
__attribute__((always_inline)) inline void zero(double* p, int n) {
    if (n > 64) return void(std::memset(p, 0, sizeof(double) * static_cast<std::size_t>(n)));
    for (; n >= width; n -= width, p += width) store(p, Vec{0.0, 0.0, 0.0, 0.0});
    for (; n > 0; --n) *p++ = 0.0;
}

__attribute__((always_inline)) inline void copy(const double* from, double* to, int n) {
    if (n > 64) return void(std::memcpy(to, from, sizeof(double) * static_cast<std::size_t>(n)));
    for (; n >= width; n -= width, from += width, to += width) store(to, load(from));
    for (; n > 0; --n) *to++ = *from++;
}

// Largest size of the entries.
inline double largest(int n, const double* x) {
    Vec lanes = {0.0, 0.0, 0.0, 0.0};
    int j = 0;
    for (; j + width <= n; j += width) {
        const Vec v = load(x + j), size = v < 0.0 ? -v : v;
        lanes = size > lanes ? size : lanes;
    }
    double out = largest_of(lanes);
    for (; j < n; ++j) out = std::max(out, std::abs(x[j]));
    return out;
}

// Sum of squares and largest size of x_i w_i; the latter passes over what is no number.
inline double weighted_squares(int n, const double* x, const double* w) {
    Vec lanes = {};
    for (int j = 0; j < n; j += width) {
        const Vec v = first_of(x + j, n - j) * first_of(w + j, n - j);
        lanes += v * v;
    }
    return sum_of(lanes);
}
inline double weighted_largest(int n, const double* x, const double* w) {
    Vec lanes = {};
    for (int j = 0; j < n; j += width) {
        const Vec v = first_of(x + j, n - j) * first_of(w + j, n - j), size = v < 0.0 ? -v : v;
        lanes = size > lanes ? size : lanes;
    }
    return largest_of(lanes);
}

// Tiles of C = A^T B, or of C += A^T B: four rows by V vectors of columns, which stay in registers; A and B have K
// rows, or k where K is 0.
template <int K, bool Add, int V>
inline void gemm_tn_columns(int m, int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc) {
    for (int i = 0; i < m; i += 4) {
        Vec sum[4][V] = {};
        for (int r = 0; r < 4 && Add; ++r)
            for (int v = 0; v < V; ++v) sum[r][v] = load(C + (i + r) * ldc + 4 * v);
        const auto add = [&](int p) {
            const double *a = A + p * lda + i, *b = B + p * ldb;
            for (int r = 0; r < 4; ++r)
                for (int v = 0; v < V; ++v) sum[r][v] += a[r] * load(b + 4 * v);
        };
        if constexpr (K > 0) {
            _Pragma("GCC unroll 8") for (int p = 0; p < K; ++p) add(p);
        } else {
            for (int p = 0; p < k; ++p) add(p);
        }
        for (int r = 0; r < 4; ++r)
            for (int v = 0; v < V; ++v) store(C + (i + r) * ldc + 4 * v, sum[r][v]);
    }
}

// Rows and columns of a block of four by four, the other way round.
__attribute__((always_inline)) inline void transpose(Vec& a, Vec& b, Vec& c, Vec& d) {
#if defined(__clang__) || __GNUC__ >= 12
    const Vec ab0 = __builtin_shufflevector(a, b, 0, 4, 2, 6), ab1 = __builtin_shufflevector(a, b, 1, 5, 3, 7);
    const Vec cd0 = __builtin_shufflevector(c, d, 0, 4, 2, 6), cd1 = __builtin_shufflevector(c, d, 1, 5, 3, 7);
    a = __builtin_shufflevector(ab0, cd0, 0, 1, 4, 5), b = __builtin_shufflevector(ab1, cd1, 0, 1, 4, 5);
    c = __builtin_shufflevector(ab0, cd0, 2, 3, 6, 7), d = __builtin_shufflevector(ab1, cd1, 2, 3, 6, 7);
#else
    const Vec rows[4] = {a, b, c, d};
    for (int i = 0; i < 4; ++i) a[i] = rows[i][0], b[i] = rows[i][1], c[i] = rows[i][2], d[i] = rows[i][3];
#endif
}

// A <- A + A' + H, H symmetric or null; n is rounded up to whole vectors.
inline void symmetrise(int n, double* A, int lda, const double* H, int ldh) {
    for (int i = 0; i < n; i += 4)
        for (int j = i; j < n; j += 4) {
            double *upper = A + i * lda + j, *lower = A + j * lda + i;
            Vec rows[4], other[4];
            for (int r = 0; r < 4; ++r) other[r] = load(lower + r * lda);
            transpose(other[0], other[1], other[2], other[3]);
            for (int r = 0; r < 4; ++r) rows[r] = load(upper + r * lda) + other[r];
            if (H)
                for (int r = 0; r < 4; ++r) rows[r] += load(H + (i + r) * ldh + j);
            for (int r = 0; r < 4; ++r) store(upper + r * lda, rows[r]);
            if (i == j) continue;
            transpose(rows[0], rows[1], rows[2], rows[3]);
            for (int r = 0; r < 4; ++r) store(lower + r * lda, rows[r]);
        }
}

// Splits `vectors` columns of vectors into tiles of three, two and one of them: tile(std::integral_constant, first).
template <class Tile>
inline void for_tiles(int vectors, Tile tile) {
    int at = 0;
    for (; vectors - at > 4 || vectors - at == 3; at += 3) tile(std::integral_constant<int, 3>(), 4 * at);
    for (; vectors - at >= 2; at += 2) tile(std::integral_constant<int, 2>(), 4 * at);
    if (vectors > at) tile(std::integral_constant<int, 1>(), 4 * at);
}

// work(std::integral_constant of n) where there is code for that size, else work(that of 0).
template <class Work>
inline auto for_few(int n, const Work& work) {
    switch (n) {
    case 1:
        return work(std::integral_constant<int, 1>());
    case 2:
        return work(std::integral_constant<int, 2>());
    case 3:
        return work(std::integral_constant<int, 3>());
    case 4:
        return work(std::integral_constant<int, 4>());
    case 5:
        return work(std::integral_constant<int, 5>());
    case 6:
        return work(std::integral_constant<int, 6>());
    case 7:
        return work(std::integral_constant<int, 7>());
    case 8:
        return work(std::integral_constant<int, 8>());
    }
    return work(std::integral_constant<int, 0>());
}

// C (m x n) += A^T B with A (k x m), B (k x n), all row-major, or without `Add` C = A^T B; K is k where the compiler is
// to know it. m and n are rounded up to whole vectors, so C needs padded(m) rows and every leading dimension must be
// padded.
template <int K = 0, bool Add = true>
inline void gemm_tn(int m, int n, int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc) {
    for_tiles(padded(n) / 4,
              [&](auto V, int j) { gemm_tn_columns<K, Add, V()>(m, k, A, lda, B + j, ldb, C + j, ldc); });
}

// R rows of C += scale A B over V vectors of columns.
template <int R, int V>
inline void gemm_nn_tile(int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc, double scale) {
    Vec sum[R][V];
    for (int r = 0; r < R; ++r)
        for (int v = 0; v < V; ++v) sum[r][v] = Vec{0.0, 0.0, 0.0, 0.0};
    for (int p = 0; p < k; ++p) {
        const double *a = A + p, *b = B + p * ldb;
        for (int r = 0; r < R; ++r)
            for (int v = 0; v < V; ++v) sum[r][v] += a[r * lda] * load(b + 4 * v);
    }
    for (int r = 0; r < R; ++r)
        for (int v = 0; v < V; ++v) {
            double* c = C + r * ldc + 4 * v;
            store(c, load(c) + scale * sum[r][v]);
        }
}

// C (m x n) += scale A B with A (m x k), B (k x n), all row-major; n is rounded up to whole vectors.
inline void gemm_nn(int m, int n, int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc,
                    double scale = 1.0) {
    for_tiles(padded(n) / 4, [&](auto V, int j) {
        const auto rows = [&](auto R, int i) {
            gemm_nn_tile<R(), V()>(k, A + i * lda, lda, B + j, ldb, C + i * ldc + j, ldc, scale);
        };
        int i = 0;
        for (; i + 4 <= m; i += 4) rows(std::integral_constant<int, 4>(), i);
        if (m - i == 3) rows(std::integral_constant<int, 3>(), i);
        if (m - i == 2) rows(std::integral_constant<int, 2>(), i);
        if (m - i == 1) rows(std::integral_constant<int, 1>(), i);
    });
}

// z += x y entry by entry, over whole vectors.
__attribute__((always_inline)) inline void multiply_add(int n, const double* x, const double* y, double* z) {
    for (int j = 0; j < n; j += width) store(z + j, load(z + j) + load(x + j) * load(y + j));
}

// y <- a times numbers that are `stride` apart, over whole vectors with zeros behind the last.
__attribute__((always_inline)) inline void gather(int n, double a, const double* x, int stride, double* y) {
    for (; n >= width; n -= width, x += width * stride, y += width)
        store(y, a * Vec{x[0], x[stride], x[2 * stride], x[3 * stride]});
    if (n > 0) store(y, a * Vec{x[0], n > 1 ? x[stride] : 0.0, n > 2 ? x[2 * stride] : 0.0, 0.0});
}

// y <- a x, over whole vectors.
__attribute__((always_inline)) inline void scaled(int n, double a, const double* x, double* y) {
    for (int j = 0; j < n; j += width) store(y + j, a * load(x + j));
}

// y += a x, without the alias checks and the unrolling that make short loops long.
__attribute__((always_inline)) inline void axpy(int n, double a, const double* x, double* y) {
    int j = 0;
    for (; j + width <= n; j += width) store(y + j, load(y + j) + a * load(x + j));
    for (; j < n; ++j) {
        y[j] += a * x[j];
        asm volatile("" :::);  // keeps the tail of at most three a plain loop
    }
}

__attribute__((always_inline)) inline double dot(int n, const double* x, const double* y) {
    Vec lanes = {0.0, 0.0, 0.0, 0.0};
    int j = 0;
    for (; j + width <= n; j += width) lanes += load(x + j) * load(y + j);
    double sum = sum_of(lanes);
    for (; j < n; ++j) {
        sum += x[j] * y[j];
        asm volatile("" :::);
    }
    return sum;
}

// Products of R rows of A with x, in lanes that are still to be summed up; rows as long as lda allows are read by whole
// vectors.
template <int R>
__attribute__((always_inline)) inline void multiply_rows(int n, const double* A, int lda, const double* x, Vec* lanes) {
    for (int r = 0; r < R; ++r) lanes[r] = Vec{};
    int j = 0;
    for (; j + width <= n; j += width)
        for (int r = 0; r < R; ++r) lanes[r] += load(A + r * lda + j) * load(x + j);
    if (j == n) return;
    const Vec last = first_of(x + j, n - j);
    if (j + width <= lda)
        for (int r = 0; r < R; ++r) lanes[r] += load(A + r * lda + j) * last;
    else
        for (int r = 0; r < R; ++r) lanes[r] += first_of(A + r * lda + j, n - j) * last;
}

// y (m) += scale A x, A (m x n) row-major; what its rows are padded with is finite.
inline void gemv(int m, int n, const double* A, int lda, const double* x, double* y, double scale = 1.0) {
    int i = 0;
    for (; i + 4 <= m; i += 4) {
        Vec lanes[4];
        multiply_rows<4>(n, A + i * lda, lda, x, lanes);
        transpose(lanes[0], lanes[1], lanes[2], lanes[3]);
        store(y + i, load(y + i) + scale * ((lanes[0] + lanes[1]) + (lanes[2] + lanes[3])));
    }
    for (; i < m; ++i) {
        Vec lanes;
        multiply_rows<1>(n, A + i * lda, lda, x, &lanes);
        y[i] += scale * sum_of(lanes);
    }
}

// V vectors of columns of y += scale A^T x, which stay in registers; y may end within the last one.
template <int V>
inline void gemv_t_columns(int m, int n, const double* A, int lda, const double* x, double* y, double scale) {
    const int left = n - width * (V - 1);
    Vec sum[V];
    for (int v = 0; v < V - 1; ++v) sum[v] = load(y + 4 * v);
    sum[V - 1] = first_of(y + 4 * (V - 1), left);
    int i = 0;
    for (; i + 4 <= m; i += 4) {
        const double *a = A + i * lda, f[4] = {scale * x[i], scale * x[i + 1], scale * x[i + 2], scale * x[i + 3]};
        for (int v = 0; v < V; ++v, a += 4) {
            Vec part = f[0] * load(a) + f[1] * load(a + lda);
            part += f[2] * load(a + 2 * lda) + f[3] * load(a + 3 * lda);
            sum[v] += part;
        }
    }
    for (; i < m; ++i)
        for (int v = 0; v < V; ++v) sum[v] += (scale * x[i]) * load(A + i * lda + 4 * v);
    for (int v = 0; v < V - 1; ++v) store(y + 4 * v, sum[v]);
    store_first(y + 4 * (V - 1), sum[V - 1], left);
}

// y (n) += scale A^T x, A (m x n) row-major.
inline void gemv_t(int m, int n, const double* A, int lda, const double* x, double* y, double scale = 1.0) {
    const int by_vectors = padded(n) <= lda ? n : n / width * width;  // rows that are not padded have to end earlier
    for_tiles(padded(by_vectors) / width,
              [&](auto V, int j) { gemv_t_columns<V()>(m, by_vectors - j, A + j, lda, x, y + j, scale); });
    for (int k = by_vectors; k < n; ++k)
        for (int i = 0; i < m; ++i) y[k] += (scale * x[i]) * A[i * lda + k];
}

// In-place LU with partial pivoting; returns min |pivot| / max |pivot| (0 when singular or not finite).
inline double lu_factor(int n, double* A, int lda, int* pivot) {
    double smallest = INFINITY, largest = 0.0;
    for (int k = 0; k < n; ++k) {
        int best = k;
        for (int i = k + 1; i < n; ++i)
            if (std::abs(A[i * lda + k]) > std::abs(A[best * lda + k])) best = i;
        pivot[k] = best;
        if (best != k) std::swap_ranges(A + k * lda, A + k * lda + n, A + best * lda);
        const double p = std::abs(A[k * lda + k]);
        if (!(p > 0.0) || !std::isfinite(p)) return 0.0;
        smallest = std::min(smallest, p);
        largest = std::max(largest, p);
        const double inverse = 1.0 / A[k * lda + k];
        const double* top = A + k * lda;
        for (int i = k + 1; i < n; ++i) {
            double* row = A + i * lda;
            if (row[k] == 0.0) continue;
            row[k] *= inverse;
            axpy(n - k - 1, -row[k], top + k + 1, row + k + 1);
        }
    }
    return n ? smallest / largest : 1.0;
}

// Rows of a triangular solve, V vectors of columns of B: row i minus factors times rows [first, last), then scaled.
template <int V, class Factor>
inline void eliminate_row(int i, int first, int last, Factor factor, double scale, double* B, int ldb) {
    Vec sum[V];
    for (int v = 0; v < V; ++v) sum[v] = load(B + i * ldb + 4 * v);
    for (int k = first; k < last; ++k) {
        const double f = -factor(k);
        if (f == 0.0) continue;
        for (int v = 0; v < V; ++v) sum[v] += f * load(B + k * ldb + 4 * v);
    }
    for (int v = 0; v < V; ++v) store(B + i * ldb + 4 * v, scale * sum[v]);
}

// B <- A^{-1} B for a factored A; B (n x m) row-major, m a multiple of the vector's width.
inline void lu_solve(int n, const double* A, int lda, const int* pivot, double* B, int ldb, int m) {
    for (int k = 0; k < n; ++k)
        if (pivot[k] != k) std::swap_ranges(B + k * ldb, B + k * ldb + m, B + pivot[k] * ldb);
    for_tiles(m / 4, [&](auto V, int j) {
        for (int i = 1; i < n; ++i) eliminate_row<V()>(i, 0, i, [&](int k) { return A[i * lda + k]; }, 1.0, B + j, ldb);
        for (int i = n - 1; i >= 0; --i)
            eliminate_row<V()>(i, i + 1, n, [&](int k) { return A[i * lda + k]; }, 1.0 / A[i * lda + i], B + j, ldb);
    });
}

// b <- A^{-1} b for a factored A.
inline void lu_solve_vector(int n, const double* A, int lda, const int* pivot, double* b) {
    for (int k = 0; k < n; ++k)
        if (pivot[k] != k) std::swap(b[k], b[pivot[k]]);
    for (int i = 1; i < n; ++i) b[i] -= dot(i, A + i * lda, b);
    for (int i = n - 1; i >= 0; --i) b[i] = (b[i] - dot(n - i - 1, A + i * lda + i + 1, b + i + 1)) / A[i * lda + i];
}

// b <- A^{-T} b for a factored A.
inline void lu_solve_transposed(int n, const double* A, int lda, const int* pivot, double* b) {
    for (int k = 0; k < n; ++k) {
        b[k] /= A[k * lda + k];
        axpy(n - k - 1, -b[k], A + k * lda + k + 1, b + k + 1);
    }
    for (int i = n - 1; i > 0; --i) axpy(i, -b[i], A + i * lda, b);
    for (int k = n - 1; k >= 0; --k)
        if (pivot[k] != k) std::swap(b[k], b[pivot[k]]);
}

// Inverse of a small matrix in its place, rows of V vectors, by Gauss-Jordan with row pivoting; returns as `lu_factor`.
template <int V>
inline double invert_rows(int n, double* A, int lda) {
    int pivot[width * V];
    double smallest = INFINITY, largest = 0.0;
    for (int k = 0; k < n; ++k) {
        double *row = A + k * lda, most = std::abs(row[k]);
        pivot[k] = k;
        for (int i = k + 1; i < n; ++i)
            if (std::abs(A[i * lda + k]) > most) most = std::abs(A[i * lda + k]), pivot[k] = i;
        if (!(most > 0.0) || !std::isfinite(most)) return 0.0;
        smallest = std::min(smallest, most), largest = std::max(largest, most);
        if (pivot[k] != k) std::swap_ranges(row, row + n, A + pivot[k] * lda);
        const double inverse = 1.0 / row[k];
        Vec top[V];
        Indices is_k[V];  // by registers: vectors wait for numbers that were just stored one by one
        for (int v = 0; v < V; ++v) {
            const long long at = k - width * v;
            is_k[v] = Indices{0, 1, 2, 3} == Indices{at, at, at, at};
            top[v] = inverse * (is_k[v] ? Vec{1.0, 1.0, 1.0, 1.0} : load(row + width * v));
            store(row + width * v, top[v]);
        }
        for (int i = 0; i < n; ++i) {
            double* other = A + i * lda;
            if (i == k) continue;
            const double f = other[k];
            for (int v = 0; v < V; ++v)
                store(other + width * v, (is_k[v] ? Vec{0.0, 0.0, 0.0, 0.0} : load(other + width * v)) - f * top[v]);
        }
    }
    for (int k = n - 1; k >= 0; --k)
        for (int i = 0; i < n && pivot[k] != k; ++i) std::swap(A[i * lda + k], A[i * lda + pivot[k]]);
    return n ? smallest / largest : 1.0;
}

// What a matrix is solved with: its inverse where it is small, as products take no chain of divisions; else its LU.
inline constexpr int most_inverted = 16;

inline double factor(int n, double* A, int lda, int* pivot) {
    if (n <= 4) return invert_rows<1>(n, A, lda);
    if (n <= 8) return invert_rows<2>(n, A, lda);
    if (n <= 12) return invert_rows<3>(n, A, lda);
    if (n <= most_inverted) return invert_rows<4>(n, A, lda);
    return lu_factor(n, A, lda, pivot);
}

// B <- A^{-1} B with what `factor` has made of A; B (n x m) row-major, m a multiple of the vector's width.
inline void solve(int n, const double* A, int lda, const int* pivot, double* B, int ldb, int m) {
    if (n > most_inverted) return lu_solve(n, A, lda, pivot, B, ldb, m);
    for_tiles(m / width, [&](auto V, int j) {
        double given[most_inverted * width * V()];
        for (int i = 0; i < n; ++i)
            for (int v = 0; v < V(); ++v) store(given + width * (V() * i + v), load(B + i * ldb + j + width * v));
        const auto rows = [&](auto R, int i) {
            Vec sum[R()][V()] = {};
            for (int p = 0; p < n; ++p)
                for (int r = 0; r < R(); ++r)
                    for (int v = 0; v < V(); ++v)
                        sum[r][v] += A[(i + r) * lda + p] * load(given + width * (V() * p + v));
            for (int r = 0; r < R(); ++r)
                for (int v = 0; v < V(); ++v) store(B + (i + r) * ldb + j + width * v, sum[r][v]);
        };
        int i = 0;
        for (; i + 3 <= n; i += 3) rows(std::integral_constant<int, 3>(), i);
        if (n - i == 2) rows(std::integral_constant<int, 2>(), i);
        if (n - i == 1) rows(std::integral_constant<int, 1>(), i);
    });
}

// b <- A^{-1} b, and b <- A^{-T} b; by whole vectors, as the inverse has zeros as far as its rows are padded.
inline void solve_vector(int n, const double* A, int lda, const int* pivot, double* b) {
    if (n > most_inverted) return lu_solve_vector(n, A, lda, pivot, b);
    double given[most_inverted];
    for (int i = 0; i < n; i += width) store(given + i, first_of(b + i, n - i));
    zero(b, n);
    gemv(n, padded(n), A, lda, given, b);
}
inline void solve_transposed(int n, const double* A, int lda, const int* pivot, double* b) {
    if (n > most_inverted) return lu_solve_transposed(n, A, lda, pivot, b);
    double found[most_inverted] = {};
    gemv_t(n, padded(n), A, lda, b, found);
    copy(found, b, n);
}

// Lower Cholesky factor in place (upper part untouched); false when not positive definite.
inline bool cholesky(int n, double* A, int lda) {
    for (int k = 0; k < n; ++k) {
        double* row = A + k * lda;
        const double d = row[k] - dot(k, row, row);
        if (!(d > 0.0) || !std::isfinite(d)) return false;
        row[k] = std::sqrt(d);
        for (int i = k + 1; i < n; ++i) {  // one by one: each is a chain of its own
            double* below = A + i * lda;
            below[k] = (below[k] - dot(k, below, row)) / row[k];
        }
    }
    return true;
}

// B <- (L L^T)^{-1} B, B (n x m) row-major, m a multiple of the vector's width.
inline void cholesky_solve(int n, const double* L, int ldl, double* B, int ldb, int m) {
    for_tiles(m / 4, [&](auto V, int j) {
        for (int i = 0; i < n; ++i)
            eliminate_row<V()>(i, 0, i, [&](int k) { return L[i * ldl + k]; }, 1.0 / L[i * ldl + i], B + j, ldb);
        for (int i = n - 1; i >= 0; --i)
            eliminate_row<V()>(i, i + 1, n, [&](int k) { return L[k * ldl + i]; }, 1.0 / L[i * ldl + i], B + j, ldb);
    });
}

// b <- (L L^T)^{-1} b.
inline void cholesky_solve_vector(int n, const double* L, int ldl, double* b) {
    for (int i = 0; i < n; ++i) b[i] = (b[i] - dot(i, L + i * ldl, b)) / L[i * ldl + i];
    for (int i = n - 1; i >= 0; --i) {
        b[i] /= L[i * ldl + i];
        axpy(i, -b[i], L + i * ldl, b);
    }
}

}  // namespace mbocp::dense
