#include "scatter.hpp"

#include <algorithm>

#include "vectors.hpp"

namespace mbocp {

Scatter::Scatter(Places places, int zero) {
    const auto vector_of = [](const Place& p) { return p.to / 4; };
    std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) { return a.to < b.to; });
    for (std::size_t first = 0, end = 0; first < places.size(); first = end) {
        Run run{4 * vector_of(places[first]), {zero, zero, zero, zero}};
        for (; end < places.size() && vector_of(places[end]) == vector_of(places[first]); ++end)
            run.from[places[end].to - run.to] = places[end].from;
        runs_.push_back(run);
    }
}

void Scatter::apply(const double* values, int num_lanes, int count, double* const* stages) const {
    if (num_lanes == 1) {
        for (const Run& run : runs_)
            for (int i = 0; i < 4; ++i) stages[0][run.to + i] = values[run.from[i]];
        return;
    }
    for (int w = 0; w < count; w += 4) {
        double *const s0 = stages[w], *const s1 = stages[w + 1], *const s2 = stages[w + 2], *const s3 = stages[w + 3];
        for (const Run& in_memory : runs_) {
            const Run run = in_memory;  // what is stored might be it, for all that the compiler knows
            const auto in_lanes = [&](int i) { return dense::load(values + run.from[i] * num_lanes + w); };
            dense::Vec a = in_lanes(0), b = in_lanes(1), c = in_lanes(2), d = in_lanes(3);
            dense::transpose(a, b, c, d);
            dense::store(s0 + run.to, a), dense::store(s1 + run.to, b);
            dense::store(s2 + run.to, c), dense::store(s3 + run.to, d);
        }
    }
}

}  // namespace mbocp
