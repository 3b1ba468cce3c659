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

inline Vec load(const double* p) { return *reinterpret_cast<const Vec*>(p); }
inline void store(double* p, Vec v) { *reinterpret_cast<Vec*>(p) = v; }

// Rows of a stage's matrices are short: a call costs more than they do.
inline void zero(double* p, int n) {
    if (n > 64) return void(std::memset(p, 0, sizeof(double) * static_cast<std::size_t>(n)));
    for (; n >= width; n -= width, p += width) store(p, Vec{0.0, 0.0, 0.0, 0.0});
    for (; n > 0; --n) *p++ = 0.0;
}

inline void copy(const double* from, double* to, int n) {
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
    double out = std::max(std::max(lanes[0], lanes[1]), std::max(lanes[2], lanes[3]));
    for (; j < n; ++j) out = std::max(out, std::abs(x[j]));
    return out;
}

// Tiles of C += A^T B: four rows by V vectors of columns, which stay in registers.
template <int V>
inline void gemm_tn_columns(int m, int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc) {
    for (int i = 0; i < m; i += 4) {
        Vec sum[4][V];
        for (int r = 0; r < 4; ++r)
            for (int v = 0; v < V; ++v) sum[r][v] = load(C + (i + r) * ldc + 4 * v);
        for (int p = 0; p < k; ++p) {
            const double *a = A + p * lda + i, *b = B + p * ldb;
            for (int r = 0; r < 4; ++r)
                for (int v = 0; v < V; ++v) sum[r][v] += a[r] * load(b + 4 * v);
        }
        for (int r = 0; r < 4; ++r)
            for (int v = 0; v < V; ++v) store(C + (i + r) * ldc + 4 * v, sum[r][v]);
    }
}

// Rows and columns of a block of four by four, the other way round.
inline void transpose(Vec& a, Vec& b, Vec& c, Vec& d) {
    const Vec p = {a[0], b[0], c[0], d[0]}, q = {a[1], b[1], c[1], d[1]};
    const Vec r = {a[2], b[2], c[2], d[2]}, s = {a[3], b[3], c[3], d[3]};
    a = p, b = q, c = r, d = s;
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

// C (m x n) += A^T B with A (k x m), B (k x n), all row-major; m and n are rounded up to whole vectors,
// so C needs padded(m) rows and every leading dimension must be padded.
inline void gemm_tn(int m, int n, int k, const double* A, int lda, const double* B, int ldb, double* C, int ldc) {
    for_tiles(padded(n) / 4, [&](auto V, int j) { gemm_tn_columns<V()>(m, k, A, lda, B + j, ldb, C + j, ldc); });
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
    double sum = (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]);
    for (; j < n; ++j) {
        sum += x[j] * y[j];
        asm volatile("" :::);
    }
    return sum;
}

// y (m) += scale A x, A (m x n) row-major.
inline void gemv(int m, int n, const double* A, int lda, const double* x, double* y, double scale = 1.0) {
    int i = 0;
    for (; i + 4 <= m; i += 4) {
        Vec lanes[4] = {};
        const double* a = A + i * lda;
        int j = 0;
        for (; j + width <= n; j += width)
            for (int r = 0; r < 4; ++r) lanes[r] += load(a + r * lda + j) * load(x + j);
        Vec sum;
        for (int r = 0; r < 4; ++r) sum[r] = (lanes[r][0] + lanes[r][1]) + (lanes[r][2] + lanes[r][3]);
        for (; j < n; ++j) sum += x[j] * Vec{a[j], a[lda + j], a[2 * lda + j], a[3 * lda + j]};
        store(y + i, load(y + i) + scale * sum);
    }
    for (; i < m; ++i) y[i] += scale * dot(n, A + i * lda, x);
}

// V vectors of columns of y += scale A^T x, which stay in registers.
template <int V>
inline void gemv_t_columns(int m, const double* A, int lda, const double* x, double* y, double scale) {
    Vec sum[V];
    for (int v = 0; v < V; ++v) sum[v] = load(y + 4 * v);
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
    for (int v = 0; v < V; ++v) store(y + 4 * v, sum[v]);
}

// y (n) += scale A^T x, A (m x n) row-major.
inline void gemv_t(int m, int n, const double* A, int lda, const double* x, double* y, double scale = 1.0) {
    for_tiles(n / 4, [&](auto V, int j) { gemv_t_columns<V()>(m, A + j, lda, x, y + j, scale); });
    for (int j = n / 4 * 4; j < n; ++j) {
        const double* a = A + j;
        double sum = y[j];
        int i = 0;
        for (; i + 4 <= m; i += 4, a += 4 * lda) {
            const double f[4] = {scale * x[i], scale * x[i + 1], scale * x[i + 2], scale * x[i + 3]};
            sum += f[0] * a[0] + f[1] * a[lda] + f[2] * a[2 * lda] + f[3] * a[3 * lda];
        }
        for (; i < m; ++i, a += lda) sum += (scale * x[i]) * a[0];
        y[j] = sum;
    }
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
