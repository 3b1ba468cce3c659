// How large the unknowns are, by which round-off is judged.
#pragma once

#include "barrier.hpp"
#include "iterate.hpp"

namespace mbocp {

Sizes sizes_of(const Problem& problem, const Iterate& at, const Barrier& barrier);

}  // namespace mbocp
