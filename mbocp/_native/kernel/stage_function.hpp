// One evaluated function of a stage: compiled C from a shared library, a tape, or CasADi's virtual machine.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "pool.hpp"

namespace casadi {
class Function;
}

namespace mbocp {

// Compressed-column pattern of one output.
struct Pattern {
    int rows = 0, columns = 0;
    std::vector<int> row, column;  // of each nonzero, in CasADi's order
    int nnz() const { return static_cast<int>(row.size()); }
};

inline constexpr int most_lanes = 32;
// Changes with what tapes hold, and with what C is written from them: entries of the cache are found by it.
inline constexpr std::string_view tape_format = "mbocp tape 5\n";

// At one stage: arg, `call`, res. At as many stages at once as the function has lanes, which may be one: `set` and
// `share`, `call_in_lanes`, `values`; number k of an output is then at [k * num_lanes + lane].
class StageFunction {
public:
    StageFunction() = default;
    virtual ~StageFunction() = default;

    // Set inputs with arg[i] = pointer, then call; outputs land in res[i] (nonzeros only). False: not finite or failed.
    virtual bool call() = 0;

    // An input of each stage; or of all of them, which holds until it is set again.
    void set(int input, const double* const* of_stages);
    void share(int input, const double* of_all);
    // The first `count` lanes are asked for; others need not be worked out.
    bool call_in_lanes(int count = most_lanes) { return num_lanes == 1 ? call() : call_all(count); }
    const double* values(int output) const { return all_values() + num_lanes * first[output]; }
    // The outputs one after another, number k of output i being first[i] + k; after them a zero.
    const double* all_values() const { return num_lanes == 1 ? results_.data() : lane_results_; }

    int num_lanes = 1;
    std::vector<int> first;
    std::vector<const double*> arg;
    std::vector<double*> res;
    std::vector<Pattern> outputs;
    std::vector<int> input_sizes;
    int num_inputs = 0;
    bool is_for_threads = true;

    // A function `name` of the shared library at `path`, made of what `c_source.hpp` or CasADi's code generator writes.
    static std::shared_ptr<StageFunction> from_library(const std::string& path, const std::string& name);
    // A function of CasADi's, as a tape; by CasADi's virtual machine where it calls others or has loops.
    static std::shared_ptr<StageFunction> of(const casadi::Function& function);
    static std::shared_ptr<StageFunction> from_string(const std::string& serialised);
    // What `as_tape` gave.
    static std::shared_ptr<StageFunction> from_tape(std::string_view bytes);
    // The function as bytes, where it is a tape; else none.
    virtual std::string as_tape() const { return {}; }

    // The same function with memory of its own, in a fraction of the time that `from_library` takes.
    virtual std::shared_ptr<StageFunction> copy() const = 0;
    // How long it and its copies have taken so far, in instructions of a tape, each for all stages of a call; 0 of
    // compiled functions.
    virtual std::int64_t num_executed() const { return 0; }
    // The function of each of so many threads, which call it side by side; of thread 0 it is this one. False: it is not
    // for threads.
    bool copy_for(int num_threads);
    StageFunction& of(int thread) { return thread == 0 ? *this : *copies_[static_cast<std::size_t>(thread) - 1]; }

protected:
    // What is known of the other one, without its memory.
    StageFunction(const StageFunction& other)
        : num_lanes(other.num_lanes), arg(other.arg.size()), res(other.res.size()), outputs(other.outputs),
          input_sizes(other.input_sizes), num_inputs(other.num_inputs) {}
    virtual bool call_all(int /*count*/) { return false; }
    void allocate();
    // Inputs, outputs and a zero, and so many places more.
    void allocate_lanes(int more = 0);

    Pool results_, lanes_;
    std::vector<double*> lane_inputs_;
    double* lane_results_ = nullptr;

private:
    std::vector<std::shared_ptr<StageFunction>> copies_;
};

using Function = std::shared_ptr<StageFunction>;
using Numbers = std::vector<double>;

}  // namespace mbocp
