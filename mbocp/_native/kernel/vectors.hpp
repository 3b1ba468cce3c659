// From stages to lanes and back: four vectors turned over at a time.
#pragma once

#include "dense.hpp"

namespace mbocp {

// Rows become columns.
inline void transpose(dense::Vec& a, dense::Vec& b, dense::Vec& c, dense::Vec& d) {
#if defined(__clang__) || __GNUC__ >= 12
    const dense::Vec ab0 = __builtin_shufflevector(a, b, 0, 4, 2, 6), ab1 = __builtin_shufflevector(a, b, 1, 5, 3, 7);
    const dense::Vec cd0 = __builtin_shufflevector(c, d, 0, 4, 2, 6), cd1 = __builtin_shufflevector(c, d, 1, 5, 3, 7);
    a = __builtin_shufflevector(ab0, cd0, 0, 1, 4, 5), b = __builtin_shufflevector(ab1, cd1, 0, 1, 4, 5);
    c = __builtin_shufflevector(ab0, cd0, 2, 3, 6, 7), d = __builtin_shufflevector(ab1, cd1, 2, 3, 6, 7);
#else
    const dense::Vec rows[4] = {a, b, c, d};
    for (int i = 0; i < 4; ++i) a[i] = rows[i][0], b[i] = rows[i][1], c[i] = rows[i][2], d[i] = rows[i][3];
#endif
}

// to[i * W + w] = from[w][i]
template <int W>
inline void interleave(int size, const double* const* from, double* to) {
    for (int w = 0; w < W; w += 4) {
        const double* const* at = from + w;
        int i = 0;
        for (; i + 4 <= size; i += 4) {
            dense::Vec a = dense::load(at[0] + i), b = dense::load(at[1] + i), c = dense::load(at[2] + i),
                       d = dense::load(at[3] + i);
            transpose(a, b, c, d);
            double* first = to + i * W + w;
            dense::store(first, a), dense::store(first + W, b);
            dense::store(first + 2 * W, c), dense::store(first + 3 * W, d);
        }
        for (; i < size; ++i)
            for (int lane = 0; lane < 4; ++lane) to[i * W + w + lane] = at[lane][i];
    }
}

}  // namespace mbocp
