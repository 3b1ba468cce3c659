// What a tape does, one pass after another: plain data, since the code for it is there for several kinds of processors.
#pragma once

#include <cstdint>

namespace mbocp {

enum class Operation : std::int32_t {
    copy,
    negate,
    add,
    subtract,
    multiply,
    divide,
    invert,
    square_root,
    sine,
    cosine,
    absolute,
    less,
    at_most,
    equal,
    unequal,
    is_false,
    where,  // 1.0 or 0.0; where: b if a, else 0
    multiply_add,
    multiply_subtract,
    subtract_product,  // a b + c, a b - c, c - a b
    choose,            // number a of the places in list b
    add_chosen,        // c is added to that one
    skip_unless_any,   // where a is zero in all lanes of a vector, the places of list b are, too, without the next c
                       // instructions
    other              // number `c` of CasADi's operations
};

struct Instruction {
    Operation operation;
    std::int32_t to, a, b, c;  // places; `to` of one that skips: how many runs it leaves out, see `Tape::find_runs`
};

struct Passes {
    // An operation of CasADi on n numbers: f = x op y.
    using Other = void (*)(int operation, const double* x, const double* y, double* f, int n);

    const Instruction* code;
    const std::int32_t* runs;  // how many instructions of a kind follow each other
    int num_runs;
    const std::int32_t* lists;
    Other other;
};

// All instructions for one number of each place, or for `num_lanes` of them: 8, 16 or 32.
void execute(const Passes& passes, double* memory);
void execute(const Passes& passes, double* memory, int num_lanes, int stride);
// The same with AVX-512.
void execute_avx512(const Passes& passes, double* memory, int num_lanes, int stride);

}  // namespace mbocp
