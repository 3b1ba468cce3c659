// A = L D L' of symmetric matrices whose size the compiler knows, with the right-hand sides and products that follow:
// everything unrolled, factors in registers. The signs of D are the inertia, and a definite A is no special case.
#pragma once

#include <limits>

#include "dense.hpp"

namespace mbocp::dense {

#define MBOCP_UNROLL _Pragma("GCC unroll 8")
#define MBOCP_INLINE __attribute__((always_inline)) inline

template <int N>
class SmallLdl {
public:
    // From the lower triangle. False where the factors may have lost digits: without pivoting, only a definite matrix
    // is safe; another one is where the factors are no larger than it is, and no pivot is small.
    MBOCP_INLINE bool factor(const double* A, int lda) {
        double w[N][N], d[N];
        MBOCP_UNROLL for (int i = 0; i < N; ++i) MBOCP_UNROLL for (int j = 0; j <= i; ++j) w[i][j] = A[i * lda + j];
        bool is_definite = true;
        MBOCP_UNROLL for (int k = 0; k < N; ++k) {
            d[k] = w[k][k];
            is_definite = is_definite && d[k] > 0.0 && d[k] <= std::numeric_limits<double>::max();
            inverse_[k] = 1.0 / d[k];
            MBOCP_UNROLL for (int i = k + 1; i < N; ++i) l_[i][k] = w[i][k] * inverse_[k];
            MBOCP_UNROLL for (int j = k + 1; j < N; ++j) MBOCP_UNROLL for (int i = j; i < N; ++i) w[i][j] -=
                l_[i][k] * w[j][k];
        }
        negative_ = 0;
        return __builtin_expect(is_definite, 1) || check(A, lda, d);
    }

    int negative() const { return negative_; }  // entries of D

    // For `solve` later on: L below the diagonal, 1 / D on it.
    MBOCP_INLINE void keep(double* out, int ld) const {
        MBOCP_UNROLL for (int i = 0; i < N; ++i) {
            MBOCP_UNROLL for (int j = 0; j < i; ++j) out[i * ld + j] = l_[i][j];
            out[i * ld + i] = inverse_[i];
        }
    }

    // Where a vector of columns belongs.
    struct Place {
        double* at;
        int ld;
    };

    // Columns of B (N rows): X = -A^{-1} B, Y = L^{-1} B and Z = D^{-1} Y, so that B'A^{-1}B = Z'Y; of X the place of
    // each vector is given.
    template <class PlaceOf>
    MBOCP_INLINE void solve(const double* B, int ldb, const PlaceOf& place_of, double* Y, double* Z, int ldz,
                            int vectors) const {
        constexpr int wide = N <= 4 ? 3 : N <= 6 ? 2 : 1;  // that many vectors of columns stay in registers
        int v = 0;
        for (; v + wide <= vectors; v += wide) columns<wide>(B + 4 * v, ldb, v, place_of, Y + 4 * v, Z + 4 * v, ldz);
        for (; v < vectors; ++v) columns<1>(B + 4 * v, ldb, v, place_of, Y + 4 * v, Z + 4 * v, ldz);
    }

private:
    bool check(const double* A, int lda, const double (&d)[N]) {
        double largest = 0.0, growth = 0.0, smallest = std::numeric_limits<double>::infinity();
        for (int i = 0; i < N; ++i) {
            double sum = std::abs(d[i]);
            for (int j = 0; j < i; ++j) sum += l_[i][j] * l_[i][j] * std::abs(d[j]);
            for (int j = 0; j <= i; ++j) largest = std::max(largest, std::abs(A[i * lda + j]));
            if (!(sum <= std::numeric_limits<double>::max())) return false;
            growth = std::max(growth, sum), smallest = std::min(smallest, std::abs(d[i]));
            negative_ += d[i] < 0.0;
        }
        return growth <= most_growth * largest && smallest >= least_pivot * largest;
    }

    template <int V, class PlaceOf>
    MBOCP_INLINE void columns(const double* B, int ldb, int first, const PlaceOf& place_of, double* Y, double* Z,
                              int ldz) const {
        Vec b[N][V];
        MBOCP_UNROLL for (int i = 0; i < N; ++i) MBOCP_UNROLL for (int v = 0; v < V; ++v) b[i][v] =
            load(B + i * ldb + 4 * v);
        MBOCP_UNROLL for (int k = 0; k < N; ++k) MBOCP_UNROLL for (int i = k + 1; i < N; ++i)
            MBOCP_UNROLL for (int v = 0; v < V; ++v) b[i][v] -= l_[i][k] * b[k][v];
        MBOCP_UNROLL for (int i = 0; i < N; ++i) MBOCP_UNROLL for (int v = 0; v < V; ++v) {
            store(Y + i * ldz + 4 * v, b[i][v]);
            b[i][v] *= inverse_[i];
            store(Z + i * ldz + 4 * v, b[i][v]);
            b[i][v] = -b[i][v];
        }
        MBOCP_UNROLL for (int k = N - 1; k >= 0; --k) MBOCP_UNROLL for (int i = 0; i < k; ++i)
            MBOCP_UNROLL for (int v = 0; v < V; ++v) b[i][v] -= l_[k][i] * b[k][v];
        MBOCP_UNROLL for (int v = 0; v < V; ++v) {
            const Place place = place_of(first + v);
            MBOCP_UNROLL for (int i = 0; i < N; ++i) store(place.at + i * place.ld, b[i][v]);
        }
    }

    static constexpr double most_growth = 100.0;  // of |L||D||L'| over A: two digits at most are lost
    static constexpr double least_pivot = 1e-10;  // relative; far above round-off, so that its sign is certain

    double l_[N][N], inverse_[N];
    int negative_ = 0;
};

// b <- A^{-1} b with what `keep` has kept.
template <int N>
MBOCP_INLINE void ldl_solve_vector(const double* kept, int ld, double* b) {
    double x[N];
    MBOCP_UNROLL for (int i = 0; i < N; ++i) x[i] = b[i];
    MBOCP_UNROLL for (int k = 0; k < N; ++k) MBOCP_UNROLL for (int i = k + 1; i < N; ++i) x[i] -=
        kept[i * ld + k] * x[k];
    MBOCP_UNROLL for (int i = 0; i < N; ++i) x[i] *= kept[i * (ld + 1)];
    MBOCP_UNROLL for (int k = N - 1; k >= 0; --k) MBOCP_UNROLL for (int i = 0; i < k; ++i) x[i] -=
        kept[k * ld + i] * x[k];
    MBOCP_UNROLL for (int i = 0; i < N; ++i) b[i] = x[i];
}

template <int K, int V>
MBOCP_INLINE void subtract_tile(const double* A, int lda, const double* B, int ldb, const double* from, int ldf,
                                double* C, int ldc) {
    Vec sum[4][V];
    MBOCP_UNROLL for (int r = 0; r < 4; ++r) MBOCP_UNROLL for (int v = 0; v < V; ++v) sum[r][v] =
        load(from + r * ldf + 4 * v);
    MBOCP_UNROLL for (int p = 0; p < K; ++p) MBOCP_UNROLL for (int r = 0; r < 4; ++r)
        MBOCP_UNROLL for (int v = 0; v < V; ++v) sum[r][v] -= A[p * lda + r] * load(B + p * ldb + 4 * v);
    MBOCP_UNROLL for (int r = 0; r < 4; ++r) MBOCP_UNROLL for (int v = 0; v < V; ++v)
        store(C + r * ldc + 4 * v, sum[r][v]);
}

// C (m x n) = from - A'B with A (K x m), B (K x n); m and n are rounded up to whole vectors.
template <int K>
MBOCP_INLINE void subtract_tn(int m, int n, const double* A, int lda, const double* B, int ldb, const double* from,
                              int ldf, double* C, int ldc) {
    for_tiles(padded(n) / 4, [&](auto V, int j) {
        for (int i = 0; i < m; i += 4)
            subtract_tile<K, V()>(A + i, lda, B + j, ldb, from + i * ldf + j, ldf, C + i * ldc + j, ldc);
    });
}

// P <- (Q + Q')/2 - Z'Y, symmetric as Z'Y is, with Y, Z (K x n); n is rounded up to whole vectors.
template <int K>
MBOCP_INLINE void subtract_symmetric(int n, const double* Z, const double* Y, int ldz, const double* Q, int ldq,
                                     double* P, int ldp) {
    for (int i = 0; i < n; i += 4)
        for (int j = i; j < n; j += 4) {
            Vec rows[4], other[4];
            MBOCP_UNROLL for (int r = 0; r < 4; ++r) other[r] = load(Q + (j + r) * ldq + i);
            transpose(other[0], other[1], other[2], other[3]);
            MBOCP_UNROLL for (int r = 0; r < 4; ++r) rows[r] = 0.5 * (load(Q + (i + r) * ldq + j) + other[r]);
            MBOCP_UNROLL for (int p = 0; p < K; ++p) MBOCP_UNROLL for (int r = 0; r < 4; ++r) rows[r] -=
                Z[p * ldz + i + r] * load(Y + p * ldz + j);
            MBOCP_UNROLL for (int r = 0; r < 4; ++r) store(P + (i + r) * ldp + j, rows[r]);
            if (i == j) continue;
            transpose(rows[0], rows[1], rows[2], rows[3]);
            MBOCP_UNROLL for (int r = 0; r < 4; ++r) store(P + (j + r) * ldp + i, rows[r]);
        }
}

#undef MBOCP_UNROLL
#undef MBOCP_INLINE

}  // namespace mbocp::dense
