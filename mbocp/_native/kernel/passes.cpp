#define MBOCP_WIDTH 4
#include "pass_over.hpp"

namespace mbocp {

void execute(const Passes& passes, double* memory) { pass_over<0>(passes, memory, 1); }

void execute(const Passes& passes, double* memory, int num_lanes, int stride) {
    pass_over_lanes(passes, memory, num_lanes, stride);
}

}  // namespace mbocp
