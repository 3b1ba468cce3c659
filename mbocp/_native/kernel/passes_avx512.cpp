#define MBOCP_WIDTH 8
#include "pass_over.hpp"

namespace mbocp {

void execute_avx512(const Passes& passes, double* memory, int num_lanes, int stride) {
    pass_over_lanes(passes, memory, num_lanes, stride);
}

}  // namespace mbocp
