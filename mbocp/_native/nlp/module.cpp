// Python's view of what helps interior-point solvers.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "blasfeo.hpp"

namespace nb = nanobind;

NB_MODULE(_nlp, module) {
    module.doc() = "What helps interior-point solvers.";
    module.def("accelerate_blasfeo", &mbocp::accelerate_blasfeo, nb::arg("path"),
               "Replace kernels of the BLASFEO at a path; their names.");
}
