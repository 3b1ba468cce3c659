// How large the unknowns are, by which round-off is judged.
#pragma once

#include <initializer_list>

#include "barrier.hpp"
#include "iterate.hpp"

namespace mbocp {

// Euclidean norm of all of these together, also where squares of entries have no number.
double norm(std::initializer_list<const Numbers*> parts);

Sizes sizes_of(const Problem& problem, const Iterate& at, const Barrier& barrier);

}  // namespace mbocp
