// Functions of a stage without a compiler: CasADi's instructions as a tape, or CasADi's virtual machine.
#include <casadi/casadi.hpp>

#include <algorithm>
#include <atomic>
#include <cstring>
#include <unordered_map>

#include "tape.hpp"

namespace mbocp {
namespace {

Pattern pattern_of(const casadi::Sparsity& s) {
    Pattern p;
    p.rows = static_cast<int>(s.size1()), p.columns = static_cast<int>(s.size2());
    for (const auto r : s.get_row()) p.row.push_back(static_cast<int>(r));
    for (const auto c : s.get_col()) p.column.push_back(static_cast<int>(c));
    return p;
}

const std::string choose = "choose_columns", add_chosen = "add_chosen_columns";
constexpr std::int64_t of_others = 100;  // instructions of what has none, as a table that is interpolated

// Instructions of a call, those of functions that are called counted in.
std::int64_t count_instructions(const casadi::Function& f) {
    if (f.is_a("Map")) {
        const casadi::Dict info = f.info();
        return info.at("n").to_int() * count_instructions(info.at("f").to_function());
    }
    if (!f.is_a("SXFunction") && !f.is_a("MXFunction")) return of_others;
    std::int64_t count = f.n_instructions();
    if (f.is_a("MXFunction"))
        for (casadi_int k = 0; k < f.n_instructions(); ++k)
            if (f.instruction_id(k) == casadi::OP_CALL)
                count += count_instructions(f.instruction_MX(k).which_function());
    return count;
}

class Interpreted final : public StageFunction {
public:
    Interpreted(const std::string& text, std::shared_ptr<std::atomic<std::int64_t>> executed)
        : text_(text), executed_(std::move(executed)), function_(casadi::Function::deserialize(text)),
          weight_((count_instructions(function_) + 1) / 2) {
        num_inputs = static_cast<int>(function_.n_in()), is_for_threads = false;
        for (casadi_int i = 0; i < function_.n_in(); ++i) input_sizes.push_back(static_cast<int>(function_.nnz_in(i)));
        for (casadi_int i = 0; i < function_.n_out(); ++i) outputs.push_back(pattern_of(function_.sparsity_out(i)));
        size_t sz_arg, sz_res, sz_iw, sz_w;
        function_.sz_work(sz_arg, sz_res, sz_iw, sz_w);
        arg.resize(sz_arg), res.resize(sz_res), iw_.resize(sz_iw), w_.resize(sz_w);
        allocate();
    }
    // Reads it again: what CasADi's functions share is not for several threads.
    std::shared_ptr<StageFunction> copy() const override { return std::make_shared<Interpreted>(text_, executed_); }
    std::int64_t num_executed() const override { return *executed_; }
    bool call() override {
        *executed_ += weight_;
        return function_(arg.data(), res.data(), iw_.data(), w_.data()) == 0;
    }

private:
    std::string text_;
    std::shared_ptr<std::atomic<std::int64_t>> executed_;
    casadi::Function function_;
    std::int64_t weight_;  // of a call: the virtual machine takes half as long for an instruction as a tape for a pass
    std::vector<casadi_int> iw_;
    std::vector<double> w_;
};

void other(int operation, const double* x, const double* y, double* out, int n) {
    casadi::casadi_math<double>::fun(static_cast<unsigned char>(operation), x, y, out, n);
}

// An operation on values, which have numbers: from zero on those of nodes, below -1 of inputs and constants.
struct Node {
    Operation operation;
    int number;  // of CasADi's operation, where it is another one
    int a, b, c;
    int num_uses = 0, place = -1;
    int list = -1;  // of the values of which one is chosen
};

// Numbers of nodes by operation and operands: many, and none is ever removed.
class KnownNodes {
public:
    // The number that is known of these, or the given one, which is known from now on.
    int find(std::uint32_t operation, int a, int b, int number) {
        if (2 * (count_ + 1) > entries_.size()) grow();
        Entry& entry = place({operation, a, b, number});
        if (entry.number < 0) entry = {operation, a, b, number}, ++count_;
        return entry.number;
    }

private:
    struct Entry {
        std::uint32_t operation = 0;
        int a = 0, b = 0, number = -1;
    };

    // Where one is, or has room.
    Entry& place(const Entry& wanted) {
        const std::uint64_t operands =
            std::uint64_t{static_cast<std::uint32_t>(wanted.a)} << 32 | static_cast<std::uint32_t>(wanted.b);
        std::uint64_t at = (operands + wanted.operation * 0xD6E8FEB86659FD93u) * 0x9E3779B97F4A7C15u >> 20;
        for (;; ++at) {
            Entry& entry = entries_[at & (entries_.size() - 1)];
            const bool is_wanted = entry.operation == wanted.operation && entry.a == wanted.a && entry.b == wanted.b;
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

// Writes a tape from a function's instructions: each value once, products within sums, places used again.
class Writer {
public:
    explicit Writer(const casadi::Function& f) : f_(f) {}

    std::shared_ptr<Tape> write() {
        tape_->other = other;
        read();
        count_uses();
        fuse();
        put_in_order();
        give_places();
        return tape_;
    }

private:
    static constexpr int none = -1;

    static int number_of_input(int place) { return -2 - 2 * place; }
    static int number_of_constant(int index) { return -3 - 2 * index; }

    void read() {
        std::vector<int> given;
        for (casadi_int i = 0; i < f_.n_in(); ++i) {
            const int size = static_cast<int>(f_.nnz_in(i));
            tape_->input_sizes.push_back(size);
            for (int k = 0; k < size; ++k) given.push_back(number_of_input(first_output_ + k));
            first_output_ += size + 1;
        }
        for (casadi_int i = 0; i < f_.n_out(); ++i) tape_->outputs.push_back(pattern_of(f_.sparsity_out(i)));
        results_ = values_of(f_, given);
    }

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

    const Steps& steps_of(const casadi::Function& f) {
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
                step.a = number_of_constant(index_of(f.instruction_constant(k)));
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

    // Values of a function's outputs, one number after another, from those of its inputs; calls are written out.
    std::vector<int> values_of(const casadi::Function& f, const std::vector<int>& given) {
        const Steps& steps = steps_of(f);
        std::vector<int> results(steps.num_results, none), work(f.sz_w() + 1, none);
        for (const Step& step : steps.all) {
            switch (step.id) {
            case casadi::OP_CONST:
                work[step.to] = step.a;
                break;
            case casadi::OP_INPUT:
                work[step.to] = given[step.a];
                break;
            case casadi::OP_OUTPUT:
                results[step.to] = work[step.a];
                break;
            case casadi::OP_ASSIGN:
                work[step.to] = work[step.a];
                break;
            case casadi::OP_CALL:
                call(steps.calls[step.a], work);
                break;
            default:
                work[step.to] = node_of(step.id, work[step.a], work[step.b]);
            }
        }
        return results;
    }

    void call(const Call& c, std::vector<int>& work) {
        std::vector<int> passed;
        for (const casadi_int place : c.from)
            passed.push_back(place < 0 ? number_of_constant(index_of(0.0)) : work[place]);
        const std::vector<int> returned = c.called.name() == choose       ? chosen_columns(c.called, passed)
                                          : c.called.name() == add_chosen ? chosen_sums(c.called, passed)
                                                                          : values_of(c.called, passed);
        for (std::size_t i = 0; i < c.to.size(); ++i)
            if (c.to[i] >= 0) work[c.to[i]] = returned[i];
    }

    // Columns of a table by their numbers, and sums of shares in the columns of one, see `mbocp.symbolic.columns`.
    std::vector<int> chosen_columns(const casadi::Function& f, const std::vector<int>& given) {
        const int rows = static_cast<int>(f.size1_in(0)), columns = static_cast<int>(f.size2_in(0));
        const int* which = given.data() + rows * columns;
        std::vector<int> lists, found;
        for (int i = 0; i < rows; ++i) lists.push_back(add_row(given.data() + i, rows, columns));
        for (casadi_int j = 0; j < f.size2_in(1); ++j)
            for (int i = 0; i < rows; ++i) {
                found.push_back(static_cast<int>(nodes_.size()));
                nodes_.push_back({Operation::choose, 0, which[j], none, none, 0, -1, lists[i]});
            }
        return found;
    }
    std::vector<int> chosen_sums(const casadi::Function& f, const std::vector<int>& given) {
        const int rows = static_cast<int>(f.size1_out(0)), columns = static_cast<int>(f.size2_out(0));
        const int count = static_cast<int>(f.size2_in(0)), zero = number_of_constant(index_of(0.0));
        std::vector<int> sums, lists;
        for (int k = 0; k < rows * columns; ++k) {
            sums.push_back(static_cast<int>(nodes_.size()));
            nodes_.push_back({Operation::copy, 0, zero, none, none});
        }
        for (int i = 0; i < rows; ++i) lists.push_back(add_row(sums.data() + i, rows, columns));
        for (int j = 0; j < count; ++j)
            for (int i = 0; i < rows; ++i)
                nodes_.push_back(
                    {Operation::add_chosen, 0, given[j], none, given[count + j * rows + i], 0, -1, lists[i]});
        return sums;
    }
    int add_row(const int* values, int rows, int columns) {
        lists_.emplace_back();
        for (int j = 0; j < columns; ++j) lists_.back().push_back(values[j * rows]);
        list_places_.push_back(none);
        return static_cast<int>(lists_.size()) - 1;
    }

    int index_of(double number) {
        std::uint64_t bits;
        std::memcpy(&bits, &number, sizeof bits);  // zeros have two signs, and NaN is equal to nothing
        const auto [found, is_new] = constants_.try_emplace(bits, static_cast<int>(tape_->constants.size()));
        if (is_new) tape_->constants.push_back(number);
        return found->second;
    }

    int node_of(casadi_int id, int a, int b) {
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
        const int next = static_cast<int>(nodes_.size());
        const int number = same_.find(static_cast<std::uint32_t>(same), a, b, next);
        if (number == next) nodes_.push_back({operation, static_cast<int>(id), a, b, none});
        return number;
    }

    void count_uses() {
        std::vector<bool> is_needed(nodes_.size(), false);
        for (const int r : results_)
            if (r >= 0) is_needed[r] = true, ++nodes_[r].num_uses;
        for (std::size_t k = nodes_.size(); k-- > 0;) {
            if (nodes_[k].operation == Operation::add_chosen && is_any(is_needed, lists_[nodes_[k].list]))
                is_needed[k] = true, ++nodes_[k].num_uses;
            if (!is_needed[k]) continue;
            for_operands(nodes_[k], [&](int used) { is_needed[used] = true, ++nodes_[used].num_uses; });
        }
    }

    static bool is_any(const std::vector<bool>& flags, const std::vector<int>& values) {
        return std::any_of(values.begin(), values.end(), [&](int k) { return k >= 0 && flags[k]; });
    }

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
            for (const int number : lists_[n.list]) pass(number);
    }
    static bool takes_two(const Node& n) {
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

    // A product that only one sum or difference takes becomes part of it.
    void fuse() {
        for (Node& n : nodes_) {
            if (n.num_uses == 0 || (n.operation != Operation::add && n.operation != Operation::subtract)) continue;
            const bool is_sum = n.operation == Operation::add;
            if (const Node* p = product(n.a); p)
                n = {is_sum ? Operation::multiply_add : Operation::multiply_subtract,
                     n.number,
                     p->a,
                     p->b,
                     n.b,
                     n.num_uses};
            else if (const Node* q = product(n.b); q)
                n = {is_sum ? Operation::multiply_add : Operation::subtract_product,
                     n.number,
                     q->a,
                     q->b,
                     n.a,
                     n.num_uses};
        }
    }

    const Node* product(int k) {
        if (k < 0 || nodes_[k].operation != Operation::multiply || nodes_[k].num_uses != 1) return nullptr;
        nodes_[k].num_uses = 0;
        return &nodes_[k];
    }

    // Nodes of like operations follow each other as far as their operands allow: a processor that is told what comes
    // next looks at an instruction in no time, and waits as long as for all lanes of it where it guesses wrong. Nodes
    // move by less than a window, so that values need few places. Sums that are chosen change others: nothing moves
    // past them.
    void put_in_order() {
        const int count = static_cast<int>(nodes_.size());
        std::vector<int> waits_for(nodes_.size(), 0), first_user(nodes_.size() + 1, 0), users;
        const auto for_each_use = [&](auto work) {
            for (int k = 0; k < count; ++k)
                if (nodes_[k].num_uses) for_operands(nodes_[k], [&](int used) { work(used, k); });
        };
        for_each_use([&](int used, int) { ++first_user[used + 1]; });
        for (int k = 0; k < count; ++k) first_user[k + 1] += first_user[k];
        users.resize(static_cast<std::size_t>(first_user[count]));
        std::vector<int> next(first_user.begin(), first_user.end() - 1);
        for_each_use([&](int used, int k) { users[next[used]++] = k, ++waits_for[k]; });

        constexpr int window = 4096;
        std::vector<std::vector<int>> ready(static_cast<std::size_t>(Operation::other) + 1);
        const auto operation_of = [&](int k) { return static_cast<std::size_t>(nodes_[k].operation); };
        std::vector<bool> is_placed(nodes_.size(), false);
        const auto is_barrier = [&](int k) { return nodes_[k].operation == Operation::add_chosen; };
        int lowest = 0, seen = 0;  // the first node that is not placed; those before are placed or among the ready
        const auto look_ahead = [&] {
            while (lowest < count && (is_placed[lowest] || nodes_[lowest].num_uses == 0)) ++lowest;
            for (; seen < count && seen < lowest + window; ++seen) {
                if (nodes_[seen].num_uses == 0) continue;
                if (is_barrier(seen) && seen != lowest) break;
                if (waits_for[seen] == 0) ready[operation_of(seen)].push_back(seen);
                if (is_barrier(seen)) return void(++seen);
            }
        };
        for (look_ahead(); lowest < count; look_ahead()) {
            auto& most = *std::max_element(ready.begin(), ready.end(),
                                           [](const auto& a, const auto& b) { return a.size() < b.size(); });
            for (std::size_t i = 0; i < most.size(); ++i) {  // it grows on the way
                const int k = most[i];
                order_.push_back(k), is_placed[k] = true;
                for (int u = first_user[k]; u < first_user[k + 1]; ++u)
                    if (--waits_for[users[u]] == 0 && users[u] < seen)
                        ready[operation_of(users[u])].push_back(users[u]);
            }
            most.clear();
        }
    }

    void give_places() {
        const int num_results = static_cast<int>(results_.size());
        tape_->first_constant = first_output_ + num_results + 1;
        int next = tape_->first_constant + static_cast<int>(tape_->constants.size());
        for (int r = 0; r < num_results; ++r)
            if (const int k = results_[r]; k >= 0 && nodes_[k].place < 0) nodes_[k].place = first_output_ + r;
        std::vector<int> last(nodes_.size(), none), free;
        for (const int k : order_) for_operands(nodes_[k], [&](int used) { last[used] = k; });
        for (const int k : order_) {
            Node& n = nodes_[k];
            const bool is_result = n.place >= 0;
            const int a = place_of(n.a), b = n.list >= 0 ? place_of_list(n.list) : takes_two(n) ? place_of(n.b) : a;
            const int c = n.operation == Operation::other ? n.number : n.c == none ? a : place_of(n.c);
            for_operands(n, [&](int used) {
                if (last[used] != k || nodes_[used].place < tape_->first_constant) return;
                free.push_back(nodes_[used].place), last[used] = none;
            });
            if (n.operation == Operation::add_chosen) {
                n.place = 0;  // it changes one of a list
            } else if (!is_result) {
                if (free.empty()) free.push_back(next++);
                n.place = free.back(), free.pop_back();
            }
            tape_->code.push_back({n.operation, n.place, a, b, c});
        }
        for (int r = 0; r < num_results; ++r) {
            if (results_[r] == none) continue;  // a zero of the pattern
            const int place = place_of(results_[r]), to = first_output_ + r;
            if (place != to) tape_->code.push_back({Operation::copy, to, place, place, place});
        }
        tape_->num_places = next;
    }

    // Where the places of a list begin among those of the tape; all its values have theirs by now.
    int place_of_list(int list) {
        if (list_places_[list] == none) {
            list_places_[list] = static_cast<int>(tape_->lists.size());
            tape_->lists.push_back(static_cast<std::int32_t>(lists_[list].size()));
            for (const int value : lists_[list]) tape_->lists.push_back(place_of(value));
        }
        return list_places_[list];
    }

    int place_of(int number) const {
        if (number >= 0) return nodes_[number].place;
        const int index = (-2 - number) / 2;
        return (-2 - number) % 2 ? tape_->first_constant + index : index;
    }

    const casadi::Function& f_;
    std::shared_ptr<Tape> tape_ = std::make_shared<Tape>();
    std::vector<Node> nodes_;
    std::vector<int> results_;  // value of each output number
    std::vector<int> order_;    // of the nodes that are needed
    KnownNodes same_;
    std::unordered_map<std::uint64_t, int> constants_;
    std::vector<std::vector<int>> lists_;
    std::vector<int> list_places_;
    std::unordered_map<const void*, Steps> steps_;
    int first_output_ = 0;
};

// Whether all instructions are operations on numbers, in the functions that it calls, too.
bool is_plain(const casadi::Function& f) {
    if (!f.is_a("SXFunction")) return false;
    for (const casadi::Function& called : f.find_functions())
        if (!called.is_a("SXFunction") && called.name() != choose && called.name() != add_chosen) return false;
    return true;
}

}  // namespace

std::shared_ptr<StageFunction> StageFunction::from_string(const std::string& serialised) {
    const casadi::Function f = casadi::Function::deserialize(serialised);
    if (is_plain(f)) return function_of(Writer(f).write());
    return std::make_shared<Interpreted>(serialised, std::make_shared<std::atomic<std::int64_t>>(0));
}

std::shared_ptr<StageFunction> StageFunction::from_tape(std::string_view bytes) {
    const std::shared_ptr<Tape> tape = read_tape(bytes);
    tape->other = other;
    return function_of(tape);
}

}  // namespace mbocp
