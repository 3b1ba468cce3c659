// Python's view of what helps interior-point solvers.
#include <nanobind/nanobind.h>

#include "lines.hpp"

namespace nb = nanobind;

NB_MODULE(_nlp, module) {
    module.doc() = "What helps interior-point solvers.";
    module.def("begin_whole_lines", &mbocp::begin_whole_lines, "Hand on CasADi's output line by line from now on.");
    module.def("end_whole_lines", &mbocp::end_whole_lines, "As it was before `begin_whole_lines`.");
}
