// Functions of a stage without a compiler: CasADi's instructions as a tape, or CasADi's virtual machine.
#include <casadi/casadi.hpp>

#include <algorithm>
#include <atomic>

#include "graph.hpp"
#include "tape.hpp"

namespace mbocp {
namespace {

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

// Writes a tape from a function's operations: those of a kind in runs, places used again.
class Writer {
public:
    explicit Writer(const casadi::Function& f) : graph_(f, Calls::written_out), nodes_(graph_.nodes) {}

    std::shared_ptr<Tape> write() {
        tape_->other = other;
        tape_->input_sizes = graph_.input_sizes;
        tape_->outputs = graph_.outputs;
        tape_->constants = graph_.constants;
        list_places_.assign(graph_.lists.size(), Graph::none);
        index_.assign(nodes_.size(), none);
        find_regions();
        put_in_order();
        give_places();
        return tape_;
    }

private:
    static constexpr int none = Graph::none;

    // Which nodes only those of a region need, these included: they are left out with it.
    void find_regions() {
        constexpr int nobody = -2;
        std::vector<int> needed_by(nodes_.size(), nobody);  // by nodes of one region, or by others
        region_of_.assign(nodes_.size(), none), members_.resize(graph_.regions.size());
        const auto need = [&](int used, int region) {
            if (used >= 0) needed_by[used] = needed_by[used] == nobody || needed_by[used] == region ? region : none;
        };
        for (std::size_t r = 0; r < graph_.regions.size(); ++r) {
            const Graph::Region& region = graph_.regions[r];
            std::fill(region_of_.begin() + region.first, region_of_.begin() + region.end, static_cast<int>(r));
            need(region.guard, none);
        }
        for (const int result : graph_.results) need(result, none);
        for (int k = static_cast<int>(nodes_.size()) - 1; k >= 0; --k) {
            if (nodes_[k].num_uses == 0) continue;
            if (region_of_[k] == none && needed_by[k] != nobody) region_of_[k] = needed_by[k];
            graph_.for_operands(nodes_[k], [&](int used) { need(used, region_of_[k]); });
            if (region_of_[k] != none) members_[region_of_[k]].push_back(k);
        }
        for (std::vector<int>& members : members_) std::reverse(members.begin(), members.end());
    }

    // Nodes of a region follow each other, in the place of its last one.
    void put_in_order() {
        const int count = static_cast<int>(nodes_.size());
        std::vector<int> units;
        for (int k = 0; k < count; ++k)
            if (nodes_[k].num_uses && (region_of_[k] == none || unit_of(k) == k)) units.push_back(k);
        const auto for_units = [&](int unit, auto work) {
            const int region = region_of_[unit];
            const auto pass = [&](int used) {
                if (region == none || region_of_[used] != region) work(unit_of(used));
            };
            if (region == none) return graph_.for_operands(nodes_[unit], pass);
            if (graph_.regions[region].guard >= 0) pass(graph_.regions[region].guard);
            for (const int k : members_[region]) graph_.for_operands(nodes_[k], pass);
        };
        const auto for_members = [&](int k, auto work) {
            graph_.for_operands(nodes_[k], [&](int used) {
                if (region_of_[used] == region_of_[k]) work(used);
            });
        };
        for (const int unit : in_order(units, for_units, true)) {
            const int region = region_of_[unit];
            if (region == none)
                order_.push_back(unit);
            else
                for (const int k : in_order(members_[region], for_members, false)) order_.push_back(k);
        }
    }
    // That which stands for a node's region, or itself.
    int unit_of(int k) const { return region_of_[k] == none ? k : members_[region_of_[k]].back(); }

    // Nodes of like operations follow each other as far as their operands allow: a processor that is told what comes
    // next looks at an instruction in no time, and waits as long as for all lanes of it where it guesses wrong. Nodes
    // move by less than a window, so that values need few places. Sums that are chosen change others: nothing moves
    // past them.
    template <class ForOperands>
    std::vector<int> in_order(const std::vector<int>& units, ForOperands for_operands, bool has_regions) {
        const int count = static_cast<int>(units.size());
        for (int i = 0; i < count; ++i) index_[units[i]] = i;
        std::vector<int> waits_for(units.size(), 0), first_user(units.size() + 1, 0), users, order;
        const auto for_each_use = [&](auto work) {
            for (int i = 0; i < count; ++i) for_operands(units[i], [&](int used) { work(index_[used], i); });
        };
        for_each_use([&](int used, int) { ++first_user[used + 1]; });
        for (int i = 0; i < count; ++i) first_user[i + 1] += first_user[i];
        users.resize(static_cast<std::size_t>(first_user[count]));
        std::vector<int> next(first_user.begin(), first_user.end() - 1);
        for_each_use([&](int used, int i) { users[next[used]++] = i, ++waits_for[i]; });

        constexpr int window = 4096;
        std::vector<std::vector<int>> ready(static_cast<std::size_t>(Operation::other) + 2);
        const auto operation_of = [&](int i) {
            const bool is_region = has_regions && region_of_[units[i]] != none;
            return is_region ? ready.size() - 1 : static_cast<std::size_t>(nodes_[units[i]].operation);
        };
        std::vector<bool> is_placed(units.size(), false);
        const auto is_barrier = [&](int i) { return nodes_[units[i]].operation == Operation::add_chosen; };
        int lowest = 0, seen = 0;  // the first that is not placed; those before are placed or among the ready
        const auto look_ahead = [&] {
            while (lowest < count && is_placed[lowest]) ++lowest;
            for (; seen < count && seen < lowest + window; ++seen) {
                if (is_barrier(seen) && seen != lowest) break;
                if (waits_for[seen] == 0) ready[operation_of(seen)].push_back(seen);
                if (is_barrier(seen)) return void(++seen);
            }
        };
        for (look_ahead(); lowest < count; look_ahead()) {
            auto& most = *std::max_element(ready.begin(), ready.end(),
                                           [](const auto& a, const auto& b) { return a.size() < b.size(); });
            for (std::size_t j = 0; j < most.size(); ++j) {  // it grows on the way
                const int i = most[j];
                order.push_back(units[i]), is_placed[i] = true;
                for (int u = first_user[i]; u < first_user[i + 1]; ++u)
                    if (--waits_for[users[u]] == 0 && users[u] < seen)
                        ready[operation_of(users[u])].push_back(users[u]);
            }
            most.clear();
        }
        return order;
    }

    void give_places() {
        const int num_results = static_cast<int>(graph_.results.size());
        tape_->first_constant = graph_.num_inputs + num_results + 1;
        int next = tape_->first_constant + static_cast<int>(tape_->constants.size());
        for (int r = 0; r < num_results; ++r)
            if (const int k = graph_.results[r]; k >= 0 && nodes_[k].place < 0) nodes_[k].place = graph_.num_inputs + r;
        std::vector<int> last(nodes_.size(), none), free;
        for (const int k : order_) graph_.for_operands(nodes_[k], [&](int used) { last[used] = k; });
        std::size_t skip = 0;  // where the instruction is that leaves out what comes behind it
        int region = none;
        for (const int k : order_) {
            if (region != none && region_of_[k] != region) end_region(region, skip);
            if (region_of_[k] != none && region_of_[k] != region) {
                const int guard = place_of(graph_.regions[region_of_[k]].guard);
                skip = tape_->code.size(), tape_->code.push_back({Operation::skip_unless_any, 0, guard, 0, 0});
            }
            region = region_of_[k];
            Node& n = nodes_[k];
            const bool is_result = n.place >= 0;
            const int a = place_of(n.a), b = n.list >= 0           ? place_of_list(n.list)
                                             : Graph::takes_two(n) ? place_of(n.b)
                                                                   : a;
            const int c = n.operation == Operation::other ? n.number : n.c == none ? a : place_of(n.c);
            graph_.for_operands(n, [&](int used) {
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
        if (region != none) end_region(region, skip);
        for (int r = 0; r < num_results; ++r) {
            if (graph_.results[r] == none) continue;  // a zero of the pattern
            const int place = place_of(graph_.results[r]), to = graph_.num_inputs + r;
            if (place != to) tape_->code.push_back({Operation::copy, to, place, place, place});
        }
        tape_->num_places = next;
    }

    void end_region(int region, std::size_t skip) {
        Instruction& i = tape_->code[skip];
        i.b = static_cast<int>(tape_->lists.size()), i.c = static_cast<int>(tape_->code.size() - skip - 1);
        std::vector<int> places;
        for (const int result : graph_.regions[region].results)
            if (result >= 0 && region_of_[result] == region && nodes_[result].num_uses > 0)
                places.push_back(nodes_[result].place);
        tape_->lists.push_back(static_cast<std::int32_t>(places.size()));
        tape_->lists.insert(tape_->lists.end(), places.begin(), places.end());
    }

    // Where the places of a list begin among those of the tape; all its values have theirs by now.
    int place_of_list(int list) {
        if (list_places_[list] == none) {
            list_places_[list] = static_cast<int>(tape_->lists.size());
            tape_->lists.push_back(static_cast<std::int32_t>(graph_.lists[list].size()));
            for (const int value : graph_.lists[list]) tape_->lists.push_back(place_of(value));
        }
        return list_places_[list];
    }

    int place_of(int number) const {
        if (number >= 0) return nodes_[number].place;
        return Graph::is_constant(number) ? tape_->first_constant + Graph::index_of(number) : Graph::index_of(number);
    }

    Graph graph_;
    std::vector<Node>& nodes_;
    std::shared_ptr<Tape> tape_ = std::make_shared<Tape>();
    std::vector<int> order_;  // of the nodes that are needed
    std::vector<int> region_of_, index_;
    std::vector<std::vector<int>> members_;  // of the regions
    std::vector<int> list_places_;
};

}  // namespace

std::shared_ptr<StageFunction> StageFunction::of(const casadi::Function& function) {
    if (is_plain(function)) return function_of(Writer(function).write());
    return std::make_shared<Interpreted>(function.serialize(), std::make_shared<std::atomic<std::int64_t>>(0));
}

std::shared_ptr<StageFunction> StageFunction::from_string(const std::string& serialised) {
    return of(casadi::Function::deserialize(serialised));
}

std::shared_ptr<StageFunction> StageFunction::from_tape(std::string_view bytes) {
    const std::shared_ptr<Tape> tape = read_tape(bytes);
    tape->other = other;
    return function_of(tape);
}

}  // namespace mbocp
