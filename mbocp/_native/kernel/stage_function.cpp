#include "stage_function.hpp"

#include <dlfcn.h>

#include <casadi/casadi.hpp>
#include <stdexcept>

namespace mbocp {
namespace {

using Index = long long int;  // casadi_int of generated code
using Evaluate = int (*)(const double**, double**, Index*, double*, int);
using Work = int (*)(Index*, Index*, Index*, Index*);
using Count = Index (*)(void);
using SparsityOf = const Index* (*)(Index);

// CasADi's compact form: rows, columns, dense flag or column offsets, row indices.
Pattern from_compact(const Index* s) {
    Pattern p;
    p.rows = static_cast<int>(s[0]);
    p.columns = static_cast<int>(s[1]);
    const Index* offsets = s + 2;
    if (offsets[0] == 1) {  // dense
        for (int j = 0; j < p.columns; ++j)
            for (int i = 0; i < p.rows; ++i) p.row.push_back(i), p.column.push_back(j);
        return p;
    }
    const Index* rows = offsets + p.columns + 1;
    for (int j = 0; j < p.columns; ++j)
        for (Index k = offsets[j]; k < offsets[j + 1]; ++k)
            p.row.push_back(static_cast<int>(rows[k])), p.column.push_back(j);
    return p;
}

template <class F>
F symbol(void* library, const std::string& path, const std::string& name) {
    void* found = dlsym(library, name.c_str());
    if (!found) throw std::runtime_error(path + ": no symbol " + name);
    return reinterpret_cast<F>(found);
}

class Compiled final : public StageFunction {
public:
    Compiled(const std::string& path, const std::string& name) {
        library_ = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
        if (!library_) throw std::runtime_error(dlerror());
        evaluate_ = symbol<Evaluate>(library_, path, name);
        Index sizes[4];
        symbol<Work>(library_, path, name + "_work")(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
        num_inputs = static_cast<int>(symbol<Count>(library_, path, name + "_n_in")());
        const auto n_out = symbol<Count>(library_, path, name + "_n_out")();
        const auto in = symbol<SparsityOf>(library_, path, name + "_sparsity_in");
        const auto out = symbol<SparsityOf>(library_, path, name + "_sparsity_out");
        for (int i = 0; i < num_inputs; ++i) input_sizes.push_back(from_compact(in(i)).nnz());
        for (Index i = 0; i < n_out; ++i) outputs.push_back(from_compact(out(i)));
        arg.resize(static_cast<std::size_t>(sizes[0]));
        res.resize(static_cast<std::size_t>(sizes[1]));
        iw_.resize(static_cast<std::size_t>(sizes[2]));
        w_.resize(static_cast<std::size_t>(sizes[3]));
        allocate_results();
    }
    ~Compiled() override { dlclose(library_); }
    bool call() override { return evaluate_(arg.data(), res.data(), iw_.data(), w_.data(), 0) == 0; }

private:
    void* library_ = nullptr;
    Evaluate evaluate_ = nullptr;
    std::vector<Index> iw_;
    std::vector<double> w_;
};

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
        allocate_results();
    }
    bool call() override { return function_(arg.data(), res.data(), iw_.data(), w_.data()) == 0; }

private:
    casadi::Function function_;
    std::vector<casadi_int> iw_;
    std::vector<double> w_;
};

}  // namespace

void StageFunction::allocate_results() {
    results_.reserve(outputs.size());
    for (std::size_t i = 0; i < outputs.size(); ++i) {
        results_.emplace_back(static_cast<std::size_t>(outputs[i].nnz()) + 1, 0.0);
        res[i] = results_.back().data();
    }
}

std::shared_ptr<StageFunction> StageFunction::from_library(const std::string& path, const std::string& name) {
    return std::make_shared<Compiled>(path, name);
}

std::shared_ptr<StageFunction> StageFunction::from_string(const std::string& serialised) {
    return std::make_shared<Interpreted>(serialised);
}

}  // namespace mbocp
