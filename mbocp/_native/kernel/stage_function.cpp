#include "stage_function.hpp"

#include <dlfcn.h>

#include <stdexcept>

#include "vectors.hpp"

namespace mbocp {
namespace {

using Index = long long int;  // casadi_int of generated code
using Evaluate = int (*)(const double**, double**, Index*, double*, int);
using Work = int (*)(Index*, Index*, Index*, Index*);
using Count = Index (*)(void);
using EvaluateInLanes = int (*)(double*);
using NumLanes = int (*)(void);
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
        library_.reset(dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL), [](void* p) {
            if (p) dlclose(p);
        });
        if (!library_) throw std::runtime_error(dlerror());
        void* library = library_.get();
        evaluate_ = symbol<Evaluate>(library, path, name);
        Index sizes[4];
        symbol<Work>(library, path, name + "_work")(&sizes[0], &sizes[1], &sizes[2], &sizes[3]);
        num_inputs = static_cast<int>(symbol<Count>(library, path, name + "_n_in")());
        const auto n_out = symbol<Count>(library, path, name + "_n_out")();
        const auto in = symbol<SparsityOf>(library, path, name + "_sparsity_in");
        const auto out = symbol<SparsityOf>(library, path, name + "_sparsity_out");
        for (int i = 0; i < num_inputs; ++i) input_sizes.push_back(from_compact(in(i)).nnz());
        for (Index i = 0; i < n_out; ++i) outputs.push_back(from_compact(out(i)));
        arg.resize(static_cast<std::size_t>(sizes[0]));
        res.resize(static_cast<std::size_t>(sizes[1]));
        iw_.resize(static_cast<std::size_t>(sizes[2]));
        w_.resize(static_cast<std::size_t>(sizes[3]));
        allocate();
        find_lanes(path, name);
    }
    Compiled(const Compiled& other)
        : StageFunction(other), library_(other.library_), evaluate_(other.evaluate_),
          evaluate_in_lanes_(other.evaluate_in_lanes_), room_(other.room_), iw_(other.iw_.size()), w_(other.w_.size()) {
        allocate();
        if (num_lanes > 1) allocate_lanes(room_);
    }
    std::shared_ptr<StageFunction> copy() const override { return std::make_shared<Compiled>(*this); }
    bool call() override { return evaluate_(arg.data(), res.data(), iw_.data(), w_.data(), 0) == 0; }

protected:
    bool call_all(int) override { return evaluate_in_lanes_(lanes_.data()) == 0; }

private:
    void find_lanes(const std::string& path, const std::string& name) {
        const auto number = reinterpret_cast<NumLanes>(dlsym(library_.get(), (name + "_num_lanes").c_str()));
        if (!number) return;
        num_lanes = number();
        if (num_lanes != 4 && num_lanes != 8) num_lanes = 1;
        if (num_lanes == 1) return;
        void* library = library_.get();
        evaluate_in_lanes_ = symbol<EvaluateInLanes>(library, path, name + "_in_lanes");
        room_ = static_cast<int>(symbol<Count>(library, path, name + "_room")());
        allocate_lanes(room_);
    }

    std::shared_ptr<void> library_;
    Evaluate evaluate_ = nullptr;
    EvaluateInLanes evaluate_in_lanes_ = nullptr;
    int room_ = 0;  // for what the function keeps, in numbers of all lanes
    std::vector<Index> iw_;
    std::vector<double> w_;
};

}  // namespace

void StageFunction::allocate() {
    int total = 0;
    for (const Pattern& output : outputs) first.push_back(total), total += output.nnz();
    double* at = results_.allocate(static_cast<std::size_t>(total) + 1);
    for (std::size_t i = 0; i < outputs.size(); ++i) res[i] = at + first[i];
}

void StageFunction::allocate_lanes(int more) {
    std::size_t total = 1 + static_cast<std::size_t>(more);
    for (const int size : input_sizes) total += static_cast<std::size_t>(size) + 1;
    for (const Pattern& output : outputs) total += static_cast<std::size_t>(output.nnz());
    double* at = lanes_.allocate(total * num_lanes);
    for (const int size : input_sizes) lane_inputs_.push_back(at), at += num_lanes * (size + 1);
    lane_results_ = at;
}

void StageFunction::set(int input, const double* const* of_stages) {
    const int size = input_sizes[input];
    if (num_lanes == 1)
        arg[input] = of_stages[0];
    else
        interleave(num_lanes, size, of_stages, lane_inputs_[input]);
}

void StageFunction::share(int input, const double* of_all) {
    if (num_lanes == 1) return void(arg[input] = of_all);
    double* to = lane_inputs_[input];
    for (int i = 0; i < input_sizes[input]; ++i)
        for (int lane = 0; lane < num_lanes; ++lane) *to++ = of_all ? of_all[i] : 0.0;
}

bool StageFunction::copy_for(int num_threads) {
    if (num_threads > 1 && !is_for_threads) return false;
    while (static_cast<int>(copies_.size()) + 1 < num_threads) copies_.push_back(copy());
    return true;
}

std::shared_ptr<StageFunction> StageFunction::from_library(const std::string& path, const std::string& name) {
    return std::make_shared<Compiled>(path, name);
}

}  // namespace mbocp
