// From stages to lanes and back: four vectors turned over at a time.
#pragma once

#include "dense.hpp"

namespace mbocp {

// to[i * W + w] = from[w][i], where W is a multiple of four.
inline void interleave(int W, int size, const double* const* from, double* to) {
    for (int w = 0; w < W; w += 4) {
        const double* const* at = from + w;
        int i = 0;
        for (; i + 4 <= size; i += 4) {
            dense::Vec a = dense::load(at[0] + i), b = dense::load(at[1] + i), c = dense::load(at[2] + i),
                       d = dense::load(at[3] + i);
            dense::transpose(a, b, c, d);
            double* first = to + i * W + w;
            dense::store(first, a), dense::store(first + W, b);
            dense::store(first + 2 * W, c), dense::store(first + 3 * W, d);
        }
        for (; i < size; ++i)
            for (int lane = 0; lane < 4; ++lane) to[i * W + w + lane] = at[lane][i];
    }
}

}  // namespace mbocp
