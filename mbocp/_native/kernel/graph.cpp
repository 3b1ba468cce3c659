#include "graph.hpp"

#include <algorithm>
#include <cstring>
#include <string>

namespace mbocp {
namespace {

const std::string choose = "choose_columns", add_chosen = "add_chosen_columns", where_any = "where_any";

bool is_any(const std::vector<bool>& flags, const std::vector<int>& values) {
    return std::any_of(values.begin(), values.end(), [&](int k) { return k >= 0 && flags[k]; });
}

}  // namespace

Pattern pattern_of(const casadi::Sparsity& s) {
    Pattern p;
    p.rows = static_cast<int>(s.size1()), p.columns = static_cast<int>(s.size2());
    for (const auto r : s.get_row()) p.row.push_back(static_cast<int>(r));
    for (const auto c : s.get_col()) p.column.push_back(static_cast<int>(c));
    return p;
}

bool is_plain(const casadi::Function& f) {
    if (!f.is_a("SXFunction")) return false;
    for (const casadi::Function& called : f.find_functions())
        if (!called.is_a("SXFunction") && called.name() != choose && called.name() != add_chosen) return false;
    return true;
}

Graph::Graph(const casadi::Function& f, Calls calls) : calls_(calls) {
    std::vector<int> given;
    for (casadi_int i = 0; i < f.n_in(); ++i) {
        const int size = static_cast<int>(f.nnz_in(i));
        input_sizes.push_back(size);
        for (int k = 0; k < size; ++k) given.push_back(number_of_input(num_inputs + k));
        num_inputs += size + 1;
    }
    for (casadi_int i = 0; i < f.n_out(); ++i) outputs.push_back(pattern_of(f.sparsity_out(i)));
    results = values_of(f, given);
    count_uses();
}

const Graph::Steps& Graph::steps_of(const casadi::Function& f) {
    using namespace casadi;
    const auto [found, is_new] = steps_.try_emplace(f.get());
    Steps& steps = found->second;
    if (!is_new) return steps;
    const auto offsets = [](casadi_int count, auto size) {
        std::vector<casadi_int> sums{0};
        for (casadi_int i = 0; i < count; ++i) sums.push_back(sums.back() + size(i));
        return sums;
    };
    const auto in = offsets(f.n_in(), [&](casadi_int i) { return f.nnz_in(i); });
    const auto out = offsets(f.n_out(), [&](casadi_int i) { return f.nnz_out(i); });
    steps.function = f, steps.num_results = static_cast<std::size_t>(out.back());
    SX expressions;  // of the instructions: they know which function is called
    for (casadi_int k = 0; k < f.n_instructions(); ++k) {
        const casadi_int id = f.instruction_id(k);
        const auto from = f.instruction_input(k), to = f.instruction_output(k);
        Step step{id, to.empty() ? none : static_cast<int>(to[0]), none, none};
        if (id == OP_CONST) {
            step.a = constant(f.instruction_constant(k));
        } else if (id == OP_INPUT) {
            step.a = static_cast<int>(in[from[0]] + from[1]);
        } else if (id == OP_OUTPUT) {
            step.to = static_cast<int>(out[to[0]] + to[1]), step.a = static_cast<int>(from[0]);
        } else if (id == OP_CALL) {
            if (expressions.is_empty()) expressions = f.instructions_sx();
            step.a = static_cast<int>(steps.calls.size());
            steps.calls.push_back({SX(expressions(k)).which_function(), from, to});
        } else {
            step.a = static_cast<int>(from[0]), step.b = static_cast<int>(from.size() > 1 ? from[1] : from[0]);
        }
        steps.all.push_back(step);
    }
    return steps;
}

// Values of a function's outputs, one number after another, from those of its inputs.
std::vector<int> Graph::values_of(const casadi::Function& f, const std::vector<int>& given) {
    const Steps& steps = steps_of(f);
    std::vector<int> found(steps.num_results, none), work(f.sz_w() + 1, none);
    std::vector<bool> is_own(work.size(), false);  // whether the function has worked it out
    for (const Step& step : steps.all) {
        switch (step.id) {
        case casadi::OP_CONST:
            work[step.to] = step.a, is_own[step.to] = false;
            break;
        case casadi::OP_INPUT:
            work[step.to] = given[step.a], is_own[step.to] = false;
            break;
        case casadi::OP_OUTPUT:
            found[step.to] = work[step.a];
            break;
        case casadi::OP_ASSIGN:
            work[step.to] = work[step.a], is_own[step.to] = is_own[step.a];
            break;
        case casadi::OP_CALL:
            add_call(steps.calls[step.a], work);
            for (const casadi_int place : steps.calls[step.a].to)
                if (place >= 0) is_own[place] = false;
            break;
        case casadi::OP_ADD:
        case casadi::OP_SUB:
            work[step.to] =
                sum_of(step.id == casadi::OP_ADD, work[step.a], work[step.b], is_own[step.a], is_own[step.b]);
            is_own[step.to] = true;
            break;
        default:
            work[step.to] = node_of(step.id, work[step.a], work[step.b]), is_own[step.to] = true;
        }
    }
    return found;
}

void Graph::add_call(const Call& c, std::vector<int>& work) {
    std::vector<int> passed;
    for (const casadi_int place : c.from) passed.push_back(place < 0 ? constant(0.0) : work[place]);
    const std::vector<int> returned = c.called.name() == choose                  ? chosen_columns(c.called, passed)
                                      : c.called.name() == add_chosen            ? chosen_sums(c.called, passed)
                                      : calls_ == Calls::kept                    ? results_of_call(c.called, passed)
                                      : is_where_any(c.called) && !is_in_region_ ? values_of_region(c.called, passed)
                                                                                 : values_of(c.called, passed);
    for (std::size_t i = 0; i < c.to.size(); ++i)
        if (c.to[i] >= 0) work[c.to[i]] = returned[i];
}

// What they work out is theirs alone: it is not there where they are left out. What is not theirs is copied.
std::vector<int> Graph::values_of_region(const casadi::Function& f, const std::vector<int>& given) {
    KnownNodes others;
    std::swap(same_, others), is_in_region_ = true;
    Region region{static_cast<int>(nodes.size()), 0, given[0], values_of(f, given)};
    std::swap(same_, others), is_in_region_ = false;
    const auto changes = [](const Node& n) { return n.operation == Operation::add_chosen; };
    if (is_constant(region.guard) || std::any_of(nodes.begin() + region.first, nodes.end(), changes))
        return region.results;
    const int zero = constant(0.0);
    for (int& result : region.results)
        if (result != none && result != zero && result < region.first)
            result = add_node({Operation::copy, 0, result, none, none});
    region.end = static_cast<int>(nodes.size());
    regions.push_back(region);
    return region.results;
}

std::vector<int> Graph::results_of_call(const casadi::Function& f, const std::vector<int>& given) {
    std::vector<int> found;
    Node made{call, static_cast<int>(called.size()), none, none, none};
    made.list = add_list(given);
    called.push_back(f);
    const int number = add_node(made), count = static_cast<int>(f.nnz_out());
    for (int j = 0; j < count; ++j) found.push_back(add_node({result_of_call, j, number, none, none}));
    return found;
}

// Columns of a table by their numbers, and sums of shares in the columns of one, see `mbocp.symbolic.columns`.
std::vector<int> Graph::chosen_columns(const casadi::Function& f, const std::vector<int>& given) {
    const int rows = static_cast<int>(f.size1_in(0)), columns = static_cast<int>(f.size2_in(0));
    const int* which = given.data() + rows * columns;
    std::vector<int> of_rows, found;
    if (calls_ == Calls::kept) {  // each column at once
        const int table = add_list({given.data(), which});
        for (casadi_int j = 0; j < f.size2_in(1); ++j) {
            const int number = add_node({choose_column, rows, which[j], none, none, 0, -1, table});
            for (int i = 0; i < rows; ++i) found.push_back(add_node({result_of_call, i, number, none, none}));
        }
        return found;
    }
    for (int i = 0; i < rows; ++i) {
        std::vector<int> row;
        for (int j = 0; j < columns; ++j) row.push_back(given[j * rows + i]);
        of_rows.push_back(add_list(std::move(row)));
    }
    for (casadi_int j = 0; j < f.size2_in(1); ++j)
        for (int i = 0; i < rows; ++i)
            found.push_back(add_node({Operation::choose, 0, which[j], none, none, 0, -1, of_rows[i]}));
    return found;
}

std::vector<int> Graph::chosen_sums(const casadi::Function& f, const std::vector<int>& given) {
    const int rows = static_cast<int>(f.size1_out(0)), columns = static_cast<int>(f.size2_out(0));
    const int count = static_cast<int>(f.size2_in(0)), zero = constant(0.0);
    std::vector<int> sums, of_rows;
    for (int k = 0; k < rows * columns; ++k) sums.push_back(add_node({Operation::copy, 0, zero, none, none}));
    for (int i = 0; i < rows; ++i) {
        std::vector<int> row;
        for (int j = 0; j < columns; ++j) row.push_back(sums[j * rows + i]);
        of_rows.push_back(add_list(std::move(row)));
    }
    for (int j = 0; j < count; ++j)
        for (int i = 0; i < rows; ++i)
            add_node({Operation::add_chosen, 0, given[j], none, given[count + j * rows + i], 0, -1, of_rows[i]});
    return sums;
}

int Graph::add_list(std::vector<int> values) {
    lists.push_back(std::move(values));
    return static_cast<int>(lists.size()) - 1;
}

int Graph::add_node(const Node& n) {
    nodes.push_back(n);
    return static_cast<int>(nodes.size()) - 1;
}

int Graph::constant(double number) {
    std::uint64_t bits;
    std::memcpy(&bits, &number, sizeof bits);  // zeros have two signs, and NaN is equal to nothing
    const auto [found, is_new] = constants_.try_emplace(bits, static_cast<int>(constants.size()));
    if (is_new) constants.push_back(number);
    return number_of_constant(found->second);
}

int Graph::node_of(casadi_int id, int a, int b) {
    using namespace casadi;
    static const std::unordered_map<casadi_int, Operation> known = {
        {OP_NEG, Operation::negate},   {OP_ADD, Operation::add},      {OP_TWICE, Operation::add},
        {OP_SUB, Operation::subtract}, {OP_MUL, Operation::multiply}, {OP_SQ, Operation::multiply},
        {OP_DIV, Operation::divide},   {OP_INV, Operation::invert},   {OP_SQRT, Operation::square_root},
        {OP_SIN, Operation::sine},     {OP_COS, Operation::cosine},   {OP_FABS, Operation::absolute},
        {OP_LT, Operation::less},      {OP_LE, Operation::at_most},   {OP_EQ, Operation::equal},
        {OP_NE, Operation::unequal},   {OP_NOT, Operation::is_false}, {OP_IF_ELSE_ZERO, Operation::where}};
    const auto found = known.find(id);
    const Operation operation = found == known.end() ? Operation::other : found->second;
    const bool commutes = operation == Operation::add || operation == Operation::multiply;
    if (commutes && b < a) std::swap(a, b);
    const casadi_int same = id == OP_TWICE ? casadi_int(OP_ADD) : id == OP_SQ ? casadi_int(OP_MUL) : id;
    const int next = static_cast<int>(nodes.size());
    const int number = same_.find(static_cast<std::uint32_t>(same), a, b, none, next);
    return number == next ? add_node({operation, static_cast<int>(id), a, b, none}) : number;
}

// A sum or difference, with a product in it where one of the two is one.
int Graph::sum_of(bool is_sum, int a, int b, bool is_own_a, bool is_own_b) {
    const Node* p = product(a, is_own_a);
    const Node* q = p ? nullptr : product(b, is_own_b);
    if (!p && !q) return node_of(is_sum ? casadi::OP_ADD : casadi::OP_SUB, a, b);
    const Operation operation = is_sum ? Operation::multiply_add
                                : p    ? Operation::multiply_subtract
                                       : Operation::subtract_product;
    const Node made{operation, 0, (p ? p : q)->a, (p ? p : q)->b, p ? b : a};
    const auto kind = static_cast<std::uint32_t>(operation) + 1000;  // other numbers than CasADi's
    const int next = static_cast<int>(nodes.size()), number = same_.find(kind, made.a, made.b, made.c, next);
    return number == next ? add_node(made) : number;
}

const Node* Graph::product(int number, bool is_own) const {
    return is_own && number >= 0 && nodes[number].operation == Operation::multiply ? &nodes[number] : nullptr;
}

void Graph::count_uses() {
    std::vector<bool> is_needed(nodes.size(), false);
    for (const int r : results)
        if (r >= 0) is_needed[r] = true, ++nodes[r].num_uses;
    auto region = regions.rbegin();
    for (std::size_t k = nodes.size(); k-- > 0;) {
        if (region != regions.rend() && static_cast<int>(k) < region->first) {
            const auto begin = is_needed.begin();
            if (std::find(begin + region->first, begin + region->end, true) != begin + region->end &&
                region->guard >= 0)
                is_needed[region->guard] = true, ++nodes[region->guard].num_uses;
            ++region;
        }
        if (nodes[k].operation == Operation::add_chosen && is_any(is_needed, lists[nodes[k].list]))
            is_needed[k] = true, ++nodes[k].num_uses;
        if (!is_needed[k]) continue;
        for_operands(nodes[k], [&](int used) { is_needed[used] = true, ++nodes[used].num_uses; });
    }
}

bool Graph::is_where_any(const casadi::Function& f) { return f.name() == where_any; }

bool Graph::takes_two(const Node& n) {
    if (n.operation == call || n.operation == result_of_call || n.operation == choose_column) return false;
    switch (n.operation) {
    case Operation::copy:
    case Operation::negate:
    case Operation::invert:
    case Operation::square_root:
    case Operation::sine:
    case Operation::cosine:
    case Operation::absolute:
    case Operation::is_false:
    case Operation::choose:
    case Operation::add_chosen:
        return false;
    case Operation::other:
        return casadi::casadi_math<double>::ndeps(static_cast<unsigned char>(n.number)) == 2;
    default:
        return true;
    }
}

}  // namespace mbocp
