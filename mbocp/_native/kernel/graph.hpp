// The operations on numbers that make up a function of CasADi's: what tapes and C are written from.
#pragma once

#include <casadi/casadi.hpp>

#include <cstdint>
#include <unordered_map>
#include <vector>

#include "passes.hpp"
#include "stage_function.hpp"

namespace mbocp {

// Kinds of nodes that no tape has.
constexpr Operation call = static_cast<Operation>(1000), result_of_call = static_cast<Operation>(1001),
                    choose_column = static_cast<Operation>(1002);

// An operation on values, which have numbers: from zero on those of nodes, below -1 of inputs and constants.
struct Node {
    Operation operation;
    int number;  // of CasADi's operation, where it is another one; of the function that is called; of its output; of
                 // rows
    int a, b, c;
    int num_uses = 0, place = -1;
    int list = -1;  // of the values of which one is chosen, or that are passed to a function
};

// Numbers of nodes by operation and operands: many, and none is ever removed.
class KnownNodes {
public:
    // The number that is known of these, or the given one, which is known from now on.
    int find(std::uint32_t operation, int a, int b, int c, int number) {
        if (2 * (count_ + 1) > entries_.size()) grow();
        Entry& entry = place({operation, a, b, c, number});
        if (entry.number < 0) entry = {operation, a, b, c, number}, ++count_;
        return entry.number;
    }

private:
    struct Entry {
        std::uint32_t operation = 0;
        int a = 0, b = 0, c = 0, number = -1;
    };

    // Where one is, or has room.
    Entry& place(const Entry& wanted) {
        const std::uint64_t operands =
            std::uint64_t{static_cast<std::uint32_t>(wanted.a)} << 32 | static_cast<std::uint32_t>(wanted.b);
        const std::uint64_t rest = wanted.operation + (std::uint64_t{static_cast<std::uint32_t>(wanted.c)} << 8);
        std::uint64_t at = (operands + rest * 0xD6E8FEB86659FD93u) * 0x9E3779B97F4A7C15u >> 20;
        for (;; ++at) {
            Entry& entry = entries_[at & (entries_.size() - 1)];
            const bool is_wanted = entry.operation == wanted.operation && entry.a == wanted.a && entry.b == wanted.b &&
                                   entry.c == wanted.c;
            if (entry.number < 0 || is_wanted) return entry;
        }
    }
    void grow() {
        std::vector<Entry> before(std::max<std::size_t>(1024, 2 * entries_.size()));
        before.swap(entries_);
        for (const Entry& entry : before)
            if (entry.number >= 0) place(entry) = entry;
    }

    std::vector<Entry> entries_;  // a power of two of them, half of which are free
    std::size_t count_ = 0;
};

enum class Calls { written_out, kept };

// A function's operations, each value once, products within sums. Of two values that a function works out, one a
// product and the other a sum of it, the sum has the product in it: in functions that are called, too, and wherever
// else the product is needed, so that numbers are the same to the last bit whether calls are written out or kept.
class Graph {
public:
    Graph(const casadi::Function& f, Calls calls);

    static constexpr int none = -1;
    static int number_of_input(int place) { return -2 - 2 * place; }
    static int number_of_constant(int index) { return -3 - 2 * index; }
    static bool is_constant(int number) { return number < none && (-2 - number) % 2; }
    static int index_of(int number) { return (-2 - number) / 2; }  // of an input's place, or of a constant

    static bool takes_two(const Node& n);
    // Whether a function is zero where its first input is, see `mbocp.symbolic.columns`.
    static bool is_where_any(const casadi::Function& f);
    // Passes on the number of each node that a node takes.
    template <class Work>
    void for_operands(const Node& n, Work work) const {
        const auto pass = [&](int number) {
            if (number >= 0) work(number);
        };
        pass(n.a);
        if (takes_two(n)) pass(n.b);
        pass(n.c);
        if (n.list >= 0)
            for (const int number : lists[n.list]) pass(number);
    }

    std::vector<int> input_sizes;
    std::vector<Pattern> outputs;
    std::vector<double> constants;
    std::vector<Node> nodes;   // those that are not needed have no uses
    std::vector<int> results;  // value of each output number
    std::vector<std::vector<int>> lists;
    std::vector<casadi::Function> called;
    // Where calls are written out, nodes of functions that are zero where their first input is.
    struct Region {
        int first, end, guard;
        std::vector<int> results;
    };
    std::vector<Region> regions;
    int num_inputs = 0;  // numbers, and one more for each input

private:
    // A function's instructions with the places of numbers in its inputs and outputs, which are read once.
    struct Step {
        casadi_int id;
        int to, a, b;
    };
    struct Call {
        casadi::Function called;
        std::vector<casadi_int> from, to;
    };
    struct Steps {
        casadi::Function function;  // as long as it is there no other one is at its address
        std::vector<Step> all;
        std::vector<Call> calls;
        std::size_t num_results = 0;
    };

    const Steps& steps_of(const casadi::Function& f);
    std::vector<int> values_of(const casadi::Function& f, const std::vector<int>& given);
    void add_call(const Call& c, std::vector<int>& work);
    std::vector<int> values_of_region(const casadi::Function& f, const std::vector<int>& given);
    std::vector<int> results_of_call(const casadi::Function& f, const std::vector<int>& given);
    std::vector<int> chosen_columns(const casadi::Function& f, const std::vector<int>& given);
    std::vector<int> chosen_sums(const casadi::Function& f, const std::vector<int>& given);
    int add_list(std::vector<int> values);
    int add_node(const Node& n);
    int constant(double number);
    int node_of(casadi_int id, int a, int b);
    int sum_of(bool is_sum, int a, int b, bool is_own_a, bool is_own_b);
    const Node* product(int number, bool is_own) const;
    void count_uses();

    Calls calls_;
    bool is_in_region_ = false;
    KnownNodes same_;
    std::unordered_map<std::uint64_t, int> constants_;
    std::unordered_map<const void*, Steps> steps_;
};

// Whether all instructions are operations on numbers, in the functions that it calls, too.
bool is_plain(const casadi::Function& f);

// The operation of CasADi's on numbers, and the pattern of an output.
Pattern pattern_of(const casadi::Sparsity& s);

}  // namespace mbocp
