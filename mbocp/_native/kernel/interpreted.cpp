// Functions of a stage by CasADi's virtual machine.
#include <casadi/casadi.hpp>

#include "stage_function.hpp"

namespace mbocp {
namespace {

class Interpreted final : public StageFunction {
public:
    explicit Interpreted(const std::string& text) : function_(casadi::Function::deserialize(text)) {
        num_inputs = static_cast<int>(function_.n_in());
        for (casadi_int i = 0; i < function_.n_in(); ++i) input_sizes.push_back(static_cast<int>(function_.nnz_in(i)));
        for (casadi_int i = 0; i < function_.n_out(); ++i) {
            const casadi::Sparsity s = function_.sparsity_out(i);
            Pattern p;
            p.rows = static_cast<int>(s.size1());
            p.columns = static_cast<int>(s.size2());
            for (const auto r : s.get_row()) p.row.push_back(static_cast<int>(r));
            for (const auto c : s.get_col()) p.column.push_back(static_cast<int>(c));
            outputs.push_back(p);
        }
        size_t sz_arg, sz_res, sz_iw, sz_w;
        function_.sz_work(sz_arg, sz_res, sz_iw, sz_w);
        arg.resize(sz_arg);
        res.resize(sz_res);
        iw_.resize(sz_iw);
        w_.resize(sz_w);
        allocate();
    }
    bool call() override { return function_(arg.data(), res.data(), iw_.data(), w_.data()) == 0; }

private:
    casadi::Function function_;
    std::vector<casadi_int> iw_;
    std::vector<double> w_;
};

}  // namespace

std::shared_ptr<StageFunction> StageFunction::from_string(const std::string& serialised) {
    return std::make_shared<Interpreted>(serialised);
}

}  // namespace mbocp
