// rhs + KKT d of a computed direction d, stage after stage while its blocks are in the cache.
#pragma once

#include "barrier.hpp"
#include "step.hpp"

namespace mbocp {

class KktCheck {
public:
    KktCheck(const Problem& problem, const Data& data, const Step& step, const Barrier& barrier);

    void start() { largest = curvature = 0.0; }
    // Rows of stage n, and d'Hd. `Hz` is H d of the stage, shift included, where it is known.
    void add_stage(int n, const Residual& rhs, const Increment& d, double shift, const double* Hz = nullptr);
    void add_end(const Residual& rhs, const Increment& d);

    Residual left;                      // rhs + KKT d
    Numbers of_start;                   // KKT d in the given state, which is no unknown
    double largest = 0, curvature = 0;  // entry of it; d'Hd

private:
    const Problem& problem_;
    const Data& data_;
    const Step& step_;
    const Barrier& barrier_;
    Pool work_;
};

}  // namespace mbocp
