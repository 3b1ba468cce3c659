// BLASFEO with kernels for processors with AVX2 and fused multiplications.
#pragma once

#include <string>
#include <vector>

namespace mbocp {

// Makes the BLASFEO at `path` call our kernels in place of its own three from which it builds all products of
// matrices and vectors, in this process. Names of the kernels that were replaced: none where the processor or the
// loader is another one, or where the library's own kernels compute something else.
std::vector<std::string> accelerate_blasfeo(const std::string& path);

}  // namespace mbocp
