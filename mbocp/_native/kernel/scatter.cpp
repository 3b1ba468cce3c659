#include "scatter.hpp"

#include <map>

#include "vectors.hpp"

namespace mbocp {

Scatter::Scatter(const Places& places, int zero) {
    std::map<int, Run> runs;
    for (const Place& p : places) {
        const int to = p.to / 4 * 4;
        const auto found = runs.try_emplace(to, Run{to, {zero, zero, zero, zero}}).first;
        found->second.from[p.to - to] = p.from;
    }
    for (const auto& [to, run] : runs) runs_.push_back(run);
}

void Scatter::apply(const double* values, int num_lanes, double* const* stages) const {
    if (num_lanes == 1) {
        for (const Run& run : runs_)
            for (int i = 0; i < 4; ++i) stages[0][run.to + i] = values[run.from[i]];
        return;
    }
    for (int w = 0; w < num_lanes; w += 4) {
        double *const s0 = stages[w], *const s1 = stages[w + 1], *const s2 = stages[w + 2], *const s3 = stages[w + 3];
        for (const Run& run : runs_) {
            const auto in_lanes = [&](int i) { return dense::load(values + run.from[i] * num_lanes + w); };
            dense::Vec a = in_lanes(0), b = in_lanes(1), c = in_lanes(2), d = in_lanes(3);
            dense::transpose(a, b, c, d);
            dense::store(s0 + run.to, a), dense::store(s1 + run.to, b);
            dense::store(s2 + run.to, c), dense::store(s3 + run.to, d);
        }
    }
}

}  // namespace mbocp
