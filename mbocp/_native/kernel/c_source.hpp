// C of a stage function, for as many stages at once as `mbocp/programme/lanes.h` has lanes.
//
// A compiler takes more than linear time for long functions, to allocate registers and to tell which loads and stores
// may meet. So a function becomes a row of short ones, which keep what later ones need in an array. What a function
// calls stays a function of its own, so that the code of what is called often is there once. The operations are those
// of tapes, so that the numbers are, too.
#pragma once

#include <optional>
#include <string>
#include <vector>

namespace casadi {
class Function;
}

namespace mbocp {

struct CSource {
    std::vector<std::string> functions;  // which may stand in different files
    std::string entries;                 // what is called from outside
};

// None where the function has operations that are not on numbers, or unknown in C.
std::optional<CSource> write_c(const casadi::Function& f);

}  // namespace mbocp
