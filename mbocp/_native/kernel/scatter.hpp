// From what a function returns for a stage, or for several in lanes, to the blocks of these stages.
#pragma once

#include <vector>

namespace mbocp {

// A number among a function's outputs (see StageFunction::all_values), and where it belongs, counted from the beginning
// of a stage's memory.
struct Place {
    int from, to;
};
using Places = std::vector<Place>;

class Scatter {
public:
    Scatter() = default;
    // `zero` is the place of a zero among the outputs: what is beside a number in a vector and has no place is zeroed.
    Scatter(Places places, int zero);
    // Stages' memories begin on the boundary of a vector; there are `count`, up to the lanes of a vector repeated.
    void apply(const double* values, int num_lanes, int count, double* const* stages) const;

private:
    struct Run {
        int to, from[4];
    };
    std::vector<Run> runs_;
};

}  // namespace mbocp
