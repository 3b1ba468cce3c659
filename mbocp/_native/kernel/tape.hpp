// A stage function as a list of instructions, executed for many stages at a time.
//
// Each instruction is one pass over a short row of numbers, one for each lane, so that all stages share the cost of
// looking at it. Nothing is compiled: a tape is data. The memory of a call is a row of places, each with a number for
// every lane:
//
//   inputs, each followed by one place more | outputs | a zero | constants | intermediate values
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "passes.hpp"
#include "stage_function.hpp"

namespace mbocp {

struct Tape {
    std::vector<int> input_sizes;
    std::vector<Pattern> outputs;
    std::vector<double> constants;
    std::vector<Instruction> code;
    std::vector<std::int32_t> runs;   // how many instructions of a kind follow each other, see `find_runs`
    std::vector<std::int32_t> lists;  // of places, each after how many it has
    int first_constant = 0, num_places = 0;
    Passes::Other other = nullptr;
    mutable std::atomic<std::int64_t> num_passes{0};  // so far, by all functions that execute it

    void find_runs();
    Passes passes() const { return {code.data(), runs.data(), static_cast<int>(runs.size()), lists.data(), other}; }
};

// A tape as bytes, which begin with `tape_format`, and back: nothing has to be read again. Throws std::runtime_error
// where they are no tape of this format, or say what cannot be.
std::string write_tape(const Tape& tape);
std::shared_ptr<Tape> read_tape(std::string_view bytes);

// The function that executes a tape, in as many lanes as the processor's cache has room for.
std::shared_ptr<StageFunction> function_of(std::shared_ptr<Tape> tape);

}  // namespace mbocp
