// One evaluated function of a stage: compiled C from a shared library, or CasADi's virtual machine.
#pragma once

#include <memory>
#include <string>
#include <vector>

namespace mbocp {

// Compressed-column pattern of one output.
struct Pattern {
    int rows = 0, columns = 0;
    std::vector<int> row, column;  // of each nonzero, in CasADi's order
    int nnz() const { return static_cast<int>(row.size()); }
};

class StageFunction {
public:
    virtual ~StageFunction() = default;

    // Set inputs with arg[i] = pointer, then call; outputs land in res[i] (nonzeros only). False: not finite or failed.
    virtual bool call() = 0;

    std::vector<const double*> arg;
    std::vector<double*> res;
    std::vector<Pattern> outputs;
    std::vector<int> input_sizes;
    int num_inputs = 0;

    // A function `name` of the shared library at `path`, as CasADi's code generator writes it.
    static std::shared_ptr<StageFunction> from_library(const std::string& path, const std::string& name);
    // A serialised casadi::Function, evaluated by CasADi's virtual machine.
    static std::shared_ptr<StageFunction> from_string(const std::string& serialised);

protected:
    void allocate_results();  // one buffer an output
    std::vector<std::vector<double>> results_;
};

using Function = std::shared_ptr<StageFunction>;
using Numbers = std::vector<double>;

}  // namespace mbocp
