#include "c_source.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <stdexcept>
#include <utility>

#include "graph.hpp"

namespace mbocp {
namespace {

constexpr int longest_piece = 250;  // statements: of a few hundred the calls and what is kept cost nothing
constexpr int most_in_a_row = 3;    // of copies, beyond which a loop takes their place

struct Unknown : std::runtime_error {
    using std::runtime_error::runtime_error;
};

std::string index(const std::string& array, int i) { return array + '[' + std::to_string(i) + ']'; }

// A number in every lane, to the last bit.
std::string literal(double number) {
    if (std::isnan(number)) return "mbocp_all(0./0.)";
    if (std::isinf(number)) return number > 0.0 ? "mbocp_all(1./0.)" : "mbocp_all(-1./0.)";
    char text[40];
    std::snprintf(text, sizeof text, "mbocp_all(%a)", number);
    return text;
}

// The name in `lanes.h` of an operation that tapes leave to CasADi.
const char* name_of_other(int operation) {
    using namespace casadi;
    static const std::map<int, const char*> names = {{OP_EXP, "each_exp"},
                                                     {OP_LOG, "each_log"},
                                                     {OP_POW, "each_pow"},
                                                     {OP_CONSTPOW, "each_pow"},
                                                     {OP_TAN, "each_tan"},
                                                     {OP_ASIN, "each_asin"},
                                                     {OP_ACOS, "each_acos"},
                                                     {OP_ATAN, "each_atan"},
                                                     {OP_SINH, "each_sinh"},
                                                     {OP_COSH, "each_cosh"},
                                                     {OP_TANH, "each_tanh"},
                                                     {OP_ASINH, "each_asinh"},
                                                     {OP_ACOSH, "each_acosh"},
                                                     {OP_ATANH, "each_atanh"},
                                                     {OP_FLOOR, "each_floor"},
                                                     {OP_CEIL, "each_ceil"},
                                                     {OP_FMOD, "each_fmod"},
                                                     {OP_ERF, "each_erf"},
                                                     {OP_ATAN2, "each_atan2"},
                                                     {OP_HYPOT, "each_hypot"},
                                                     {OP_LOG1P, "each_log1p"},
                                                     {OP_EXPM1, "each_expm1"},
                                                     {OP_FMIN, "fmin"},
                                                     {OP_FMAX, "fmax"},
                                                     {OP_COPYSIGN, "each_copysign"},
                                                     {OP_SIGN, "sign"},
                                                     {OP_AND, "and"},
                                                     {OP_OR, "or"},
                                                     {OP_REMAINDER, "each_remainder"}};
    const auto found = names.find(operation);
    if (found == names.end()) throw Unknown("operation " + std::to_string(operation));
    return found->second;
}

// How others call a function: its name, numbers that go in and out, and room for what it keeps. Each input is where its
// numbers are, one after another: what others have there need not be copied.
struct Callee {
    std::string name;
    std::vector<int> input_sizes;
    int num_inputs = 0, num_outputs = 0, room = 0;
};

// The pieces of one function.
class Body {
public:
    Body(const Graph& graph, const std::vector<Callee>& callees, std::string name)
        : graph_(graph), nodes_(graph.nodes), callees_(callees), name_(std::move(name)) {}

    Callee write(std::vector<std::string>& functions) {
        const std::size_t count = nodes_.size();
        piece_of_.assign(count, 0), last_piece_.assign(count, none), slot_.assign(count, none);
        twin_.assign(count, none), local_in_.assign(count, none);
        list_slots_.assign(graph_.lists.size(), none);
        input_in_.assign(static_cast<std::size_t>(graph_.num_inputs), none);
        for (std::size_t i = 0; i < graph_.input_sizes.size(); ++i)
            for (int j = 0; j <= graph_.input_sizes[i]; ++j)
                memory_of_input_.push_back({index("x", static_cast<int>(i)), j});
        find_twins();
        find_sums();
        find_passed_columns();
        cut();
        find_outputs();
        begin_piece();
        for (std::size_t k = 0; k < count; ++k) {
            const int number = static_cast<int>(k);
            if (nodes_[k].num_uses == 0 || local_in_[k] != none) continue;
            if (piece_of_[k] != piece_) end_piece(functions), ++piece_, begin_piece();
            add(number);
        }
        std::vector<int> left, places;
        for (std::size_t r = 0; r < graph_.results.size(); ++r)
            if (!is_written_[r]) left.push_back(graph_.results[r]), places.push_back(static_cast<int>(r));
        put("y", left, [&](std::size_t i) { return places[i]; });
        end_piece(functions);
        std::string all = head(name_) + "V* s=k+" + std::to_string(num_slots_) + ";\n(void)s;\n";
        for (int p = 0; p <= piece_; ++p) all += name_of_piece(p) + "(x,y,k,s);\n";
        functions.push_back(all + "}\n");
        const int num_outputs = static_cast<int>(graph_.results.size());
        return {name_, graph_.input_sizes, graph_.num_inputs, num_outputs, num_slots_ + scratch_};
    }

private:
    static constexpr int none = Graph::none;

    static std::string head(const std::string& name, const char* more = "") {
        return "void " + name + "(const V* const* restrict x, V* restrict y, V* restrict k" + more + ") {\n";
    }
    std::string name_of_piece(int p) const { return name_ + '_' + std::to_string(p); }

    // Sines and cosines of the same angle, which come from one call.
    void find_twins() {
        std::map<int, int> sines, cosines;
        for (std::size_t k = 0; k < nodes_.size(); ++k) {
            const Node& n = nodes_[k];
            if (n.num_uses == 0 || (n.operation != Operation::sine && n.operation != Operation::cosine)) continue;
            const bool is_sine = n.operation == Operation::sine;
            const auto& others = is_sine ? cosines : sines;
            const auto other = others.find(n.a);
            if (other != others.end()) twin_[other->second] = static_cast<int>(k);
            (is_sine ? sines : cosines)[n.a] = static_cast<int>(k);
        }
    }

    // Sums whose terms are chosen are in memory, those of a list one after another.
    void find_sums() {
        for (const Node& n : nodes_) {
            if (n.num_uses == 0 || n.operation != Operation::add_chosen || list_slots_[n.list] != none) continue;
            list_slots_[n.list] = num_slots_;
            for (const int sum : graph_.lists[n.list]) slot_[sum] = num_slots_++;
        }
    }

    // Columns that calls take as they are, and nothing else does, are read where the table is.
    void find_passed_columns() {
        std::vector<int> num_passed(nodes_.size(), 0);
        for (const Node& n : nodes_) {
            if (n.operation != call || n.num_uses == 0) continue;
            const int* values = graph_.lists[n.list].data();
            for (const int size : callees_[n.number].input_sizes) {
                if (const int column = column_of(values, size); column != none) ++num_passed[column];
                values += size;
            }
        }
        is_passed_.assign(nodes_.size(), false);
        for (std::size_t k = 0; k < nodes_.size(); ++k) is_passed_[k] = num_passed[k] > 0;
        for (const Node& n : nodes_)
            if (n.operation == result_of_call && n.num_uses != num_passed[n.a]) is_passed_[n.a] = false;
    }
    // The column that so many values are, or none.
    int column_of(const int* values, int size) const {
        const int column = size > 0 && values[0] >= 0 ? nodes_[values[0]].a : none;
        if (column < 0 || nodes_[column].operation != choose_column || nodes_[column].number != size) return none;
        for (int j = 0; j < size; ++j) {
            if (values[j] < 0) return none;
            const Node& n = nodes_[values[j]];
            if (n.operation != result_of_call || n.a != column || n.number != j) return none;
        }
        return column;
    }

    void cut() {
        int statements = 0, piece = 0;
        for (std::size_t k = 0; k < nodes_.size(); ++k) {
            const Node& n = nodes_[k];
            if (n.num_uses == 0) continue;
            if (n.operation != result_of_call && ++statements > longest_piece) statements = 1, ++piece;
            piece_of_[k] = piece;
            graph_.for_operands(n, [&](int used) { last_piece_[used] = std::max(last_piece_[used], piece); });
        }
        for (std::size_t k = nodes_.size(); k-- > 0;) {  // the number of a column that is passed is read by the call
            const Node& n = nodes_[k];
            const bool is_of_passed = n.operation == result_of_call && is_passed_[n.a];
            if (n.num_uses > 0 && n.a >= 0 && (is_of_passed || is_passed_[k]))
                last_piece_[n.a] = std::max(last_piece_[n.a], last_piece_[k]);
        }
        for (std::size_t k = 0; k < nodes_.size(); ++k)  // the second one is there as soon as the first
            if (twin_[k] != none) piece_of_[twin_[k]] = piece_of_[k];
        slots_until_.resize(static_cast<std::size_t>(piece) + 1);
    }

    void find_outputs() {
        outputs_of_.assign(nodes_.size(), {});
        is_written_.assign(graph_.results.size(), false);
        for (std::size_t r = 0; r < graph_.results.size(); ++r) {
            const int value = graph_.results[r];
            if (value >= 0 && slot_[value] == none && nodes_[value].operation != result_of_call)
                outputs_of_[value].push_back(static_cast<int>(r)), is_written_[r] = true;
        }
    }

    void begin_piece() { text_ = head(name_of_piece(piece_), ", V* restrict s"); }
    void end_piece(std::vector<std::string>& functions) {
        functions.push_back(text_ + "(void)x; (void)y; (void)k; (void)s;\n}\n");
        for (const int slot : slots_until_[piece_]) free_.push_back(slot);
    }

    static std::string variable(int number) { return 'v' + std::to_string(number); }

    // What stands for a value in the piece.
    std::string ref(int number) {
        if (Graph::is_constant(number)) return literal(graph_.constants[Graph::index_of(number)]);
        if (number < none) {
            const int place = Graph::index_of(number);
            const std::string name = 'x' + std::to_string(place);
            const auto& [array, i] = memory_of_input_[place];
            if (input_in_[place] != piece_) text_ += "const V " + name + '=' + index(array, i) + ";\n";
            input_in_[place] = piece_;
            return name;
        }
        if (is_sum(number)) return index("k", slot_[number]);
        if (local_in_[number] != piece_)
            text_ += "const V " + variable(number) + '=' + index("k", slot_[number]) + ";\n",
                local_in_[number] = piece_;
        return variable(number);
    }
    bool is_sum(int number) const { return nodes_[number].operation == Operation::copy && slot_[number] != none; }

    // The node has its value from here on.
    void define(int number) {
        local_in_[number] = piece_;
        for (const int r : outputs_of_[number]) text_ += index("y", r) + '=' + variable(number) + ";\n";
        if (last_piece_[number] <= piece_) return;
        if (free_.empty()) free_.push_back(num_slots_++);
        slot_[number] = free_.back(), free_.pop_back();
        slots_until_[last_piece_[number]].push_back(slot_[number]);
        text_ += index("k", slot_[number]) + '=' + variable(number) + ";\n";
    }

    void add(int number) {
        const Node& n = nodes_[number];
        if (n.operation == call) return add_call(number);
        if (n.operation == choose_column) return add_column(number);
        if (n.operation == result_of_call) {
            slot_[number] = slot_[n.a] + n.number, local_in_[number] = piece_ - 1;  // it is read where it is used
            return;
        }
        if (n.operation == Operation::add_chosen) {
            const std::string to = "k+" + std::to_string(list_slots_[n.list]);
            text_ += "mbocp_add_chosen(" + to + ',' + std::to_string(graph_.lists[n.list].size()) + ',' + ref(n.a) +
                     ',' + ref(n.c) + ");\n";
            local_in_[number] = piece_;
            return;
        }
        if (is_sum(number)) {
            text_ += index("k", slot_[number]) + '=' + ref(n.a) + ";\n", local_in_[number] = piece_;
            return;
        }
        const int twin = twin_[number];
        if (twin != none && local_in_[twin] == none) {
            const char* function = n.operation == Operation::sine ? "mbocp_sin_and_cos(" : "mbocp_cos_and_sin(";
            const std::string angle = ref(n.a), other = variable(twin);
            text_ += "V " + other + ";\nconst V " + variable(number) + '=' + function + angle + ",&" + other + ");\n";
            define(number), define(twin);
            return;
        }
        const std::string value = value_of(n);
        text_ += "const V " + variable(number) + '=' + value + ";\n";
        define(number);
    }

    void add_call(int number) {
        const Node& n = nodes_[number];
        const Callee& callee = callees_[n.number];
        slot_[number] = num_slots_, num_slots_ += callee.num_outputs, local_in_[number] = piece_;
        std::string inputs;
        const int* values = graph_.lists[n.list].data();
        int next = 0;
        for (const int size : callee.input_sizes) {
            inputs += passed({values, values + size}, next) + ',';
            values += size, next += size + 1;
        }
        const std::string to = "k+" + std::to_string(slot_[number]);
        if (Graph::is_where_any(graph_.called[n.number])) {
            const std::string is_any = "mbocp_any(" + ref(graph_.lists[n.list][0]) + ')';
            text_ += "if (!" + is_any + ") mbocp_zero(" + to + ',' + std::to_string(callee.num_outputs) + ");\nelse ";
        }
        text_ += "{ const V* const a[]={" + inputs + "0};\n" + callee.name + "(a," + to + ",s+" +
                 std::to_string(callee.num_inputs) + "); }\n";
        scratch_ = std::max(scratch_, callee.num_inputs + callee.room);
    }

    // Where the values of an input are; from a place of the scratch on, if they are not one after another elsewhere.
    std::string passed(const std::vector<int>& values, int place) {
        const int size = static_cast<int>(values.size());
        const std::string scratch = "s+" + std::to_string(place);
        if (const int column = column_of(values.data(), size); column != none && is_passed_[column])
            return chosen(column, scratch);
        if (size > 0 && length_of_run(values, 0) == values.size()) {
            const auto [array, first] = memory_of(values[0]);
            return array + '+' + std::to_string(first);
        }
        put("s", values, [&](std::size_t i) { return place + static_cast<int>(i); });
        return scratch;
    }

    void add_column(int number) {
        const Node& n = nodes_[number];
        slots_of_list(n.list), local_in_[number] = piece_;
        if (is_passed_[number]) return;
        slot_[number] = num_slots_, num_slots_ += n.number;
        const std::string to = "k+" + std::to_string(slot_[number]);
        text_ += "mbocp_copy(" + to + ',' + chosen(number, to) + ',' + std::to_string(n.number) + ");\n";
    }

    // Where a column is, which is put there unless it stands in the table, and where not even that has one of it.
    std::string chosen(int column, const std::string& there) {
        const Node& n = nodes_[column];
        const int columns = static_cast<int>(graph_.lists[n.list].size()) / n.number;
        return "mbocp_choose_column(" + there + ",k+" + std::to_string(slots_of_list(n.list)) + ',' +
               std::to_string(n.number) + ',' + std::to_string(columns) + ',' + ref(n.a) + ')';
    }

    // Values at places of an array; those that follow each other in memory by one call.
    template <class Place>
    void put(const char* array, const std::vector<int>& values, Place place) {
        for (std::size_t i = 0; i < values.size();) {
            std::size_t count = 1;
            for (const std::size_t most = length_of_run(values, i); count < most; ++count)
                if (place(i + count) != place(i) + static_cast<int>(count)) break;
            if (count > most_in_a_row) {
                const auto [from, first] = memory_of(values[i]);
                text_ += std::string("mbocp_copy(") + array + '+' + std::to_string(place(i)) + ',' + from + '+' +
                         std::to_string(first) + ',' + std::to_string(count) + ");\n";
                i += count;
            } else {
                const std::string value = values[i] == none ? literal(0.0) : ref(values[i]);  // none: of the pattern
                text_ += index(array, place(i)) + '=' + value + ";\n";
                ++i;
            }
        }
    }
    // How many values, from number i on, are one after another in memory; one where the first has no place.
    std::size_t length_of_run(const std::vector<int>& values, std::size_t i) const {
        auto [array, place] = memory_of(values[i]);
        std::size_t count = 1;
        while (!array.empty() && i + count < values.size() && memory_of(values[i + count]) == std::pair{array, ++place})
            ++count;
        return count;
    }
    // The array and the place that a value is read from, if it has one.
    std::pair<std::string, int> memory_of(int number) const {
        if (number < none && !Graph::is_constant(number)) return memory_of_input_[Graph::index_of(number)];
        if (number >= 0 && nodes_[number].operation == result_of_call) return {"k", slot_[number]};
        return {"", 0};
    }

    std::string value_of(const Node& n) {
        const std::string a = ref(n.a), b = Graph::takes_two(n) ? ref(n.b) : "";
        const auto of_two = [&](const char* operation) { return a + operation + b; };
        const auto function = [&](const std::string& name) {
            return "mbocp_" + name + '(' + a + (b.empty() ? "" : ',' + b) + ')';
        };
        const auto of_three = [&](const char* name) {
            return std::string(name) + '(' + a + ',' + b + ',' + ref(n.c) + ')';
        };
        switch (n.operation) {
        case Operation::copy:
            return a;
        case Operation::negate:
            return '-' + a;
        case Operation::add:
            return of_two("+");
        case Operation::subtract:
            return of_two("-");
        case Operation::multiply:
            return of_two("*");
        case Operation::divide:
            return of_two("/");
        case Operation::invert:
            return literal(1.0) + '/' + a;
        case Operation::multiply_add:
            return of_three("mbocp_multiply_add");
        case Operation::multiply_subtract:
            return of_three("mbocp_multiply_subtract");
        case Operation::subtract_product:
            return of_three("mbocp_subtract_product");
        case Operation::square_root:
            return function("sqrt");
        case Operation::sine:
            return function("sin");
        case Operation::cosine:
            return function("cos");
        case Operation::absolute:
            return function("fabs");
        case Operation::less:
            return function("less");
        case Operation::at_most:
            return function("at_most");
        case Operation::equal:
            return function("equal");
        case Operation::unequal:
            return function("unequal");
        case Operation::is_false:
            return function("not");
        case Operation::where:
            return function("if");
        default:
            return function(name_of_other(n.number));
        }
    }

    // Where the values of a list stand one after another; they are put there when one is chosen for the first time.
    int slots_of_list(int list) {
        if (list_slots_[list] == none) {
            const std::vector<int>& values = graph_.lists[list];
            list_slots_[list] = num_slots_, num_slots_ += static_cast<int>(values.size());
            put("k", values, [&](std::size_t i) { return list_slots_[list] + static_cast<int>(i); });
        }
        return list_slots_[list];
    }

    const Graph& graph_;
    const std::vector<Node>& nodes_;
    const std::vector<Callee>& callees_;  // of the functions that the graph calls
    std::string name_, text_;
    int piece_ = 0, num_slots_ = 0, scratch_ = 0;
    std::vector<int> piece_of_, last_piece_;  // of a node: where it has its value, and where that is needed last
    std::vector<int> slot_;                   // where it is kept
    std::vector<int> local_in_;               // the last piece that has a variable for it
    std::vector<int> twin_;                   // the cosine of a sine's angle, or the sine of a cosine's
    std::vector<int> list_slots_, input_in_, free_;
    std::vector<std::pair<std::string, int>> memory_of_input_;
    std::vector<bool> is_passed_;  // columns
    std::vector<std::vector<int>> slots_until_, outputs_of_;
    std::vector<bool> is_written_;  // outputs, as soon as their node has its value
};

// A function and all that it calls.
class CWriter {
public:
    explicit CWriter(std::string name) : name_(std::move(name)) {}

    Callee write(const casadi::Function& f) {
        const auto found = written_.find(f.get());
        if (found != written_.end()) return found->second;
        const Graph graph(f, Calls::kept);
        std::vector<Callee> callees(graph.called.size());
        for (const Node& n : graph.nodes)
            if (n.operation == call && n.num_uses > 0) callees[n.number] = write(graph.called[n.number]);
        const std::string name = name_ + "_f" + std::to_string(written_.size());
        held_.push_back(f);
        return written_[f.get()] = Body(graph, callees, name).write(functions);
    }

    std::vector<std::string> functions;

private:
    std::string name_;
    std::map<const void*, Callee> written_;
    std::vector<casadi::Function> held_;  // so that no other one has its address
};

template <class Values>
std::string list_of(const Values& values) {
    std::string text;
    for (const auto value : values) text += std::to_string(value) + ',';
    return text + '0';
}

// What CasADi asks an external function for, of each input or output.
template <class Value>
std::string table(const std::string& kind, const std::string& name, casadi_int count, Value value) {
    std::string text = "CASADI_SYMBOL_EXPORT const " + kind + "* " + name + "(casadi_int i) {\n", cases;
    for (casadi_int i = 0; i < count; ++i) {
        text += "static const " + kind + " p" + std::to_string(i) + "[]=" + value(i) + ";\n";
        cases += "case " + std::to_string(i) + ": return p" + std::to_string(i) + ";\n";
    }
    return text + "switch (i) {\n" + cases + "default: return 0;\n}\n}\n";
}

std::string names_and_patterns(const casadi::Function& f) {
    const auto pattern = [](const casadi::Sparsity& s) { return '{' + list_of(s.compress()) + '}'; };
    const auto quoted = [](const std::string& name) { return '"' + name + '"'; };
    return table("casadi_int", f.name() + "_sparsity_in", f.n_in(),
                 [&](casadi_int i) { return pattern(f.sparsity_in(i)); }) +
           table("casadi_int", f.name() + "_sparsity_out", f.n_out(),
                 [&](casadi_int i) { return pattern(f.sparsity_out(i)); }) +
           table("char", f.name() + "_name_in", f.n_in(), [&](casadi_int i) { return quoted(f.name_in(i)); }) +
           table("char", f.name() + "_name_out", f.n_out(), [&](casadi_int i) { return quoted(f.name_out(i)); });
}

// Of the whole function: for one stage, as CasADi's own C has it, and in lanes, in memory as a tape's.
std::string entries_of(const casadi::Function& f, const Callee& callee) {
    const std::string name = f.name(), begin = "CASADI_SYMBOL_EXPORT ";
    std::vector<casadi_int> sizes_in, sizes_out;
    for (casadi_int i = 0; i < f.n_in(); ++i) sizes_in.push_back(f.nnz_in(i));
    for (casadi_int i = 0; i < f.n_out(); ++i) sizes_out.push_back(f.nnz_out(i));
    const std::string after_inputs = std::to_string(callee.num_inputs),
                      after_outputs = std::to_string(callee.num_inputs + callee.num_outputs + 1);
    const auto count = [&](const char* what, const std::string& number) {
        return begin + "casadi_int " + name + what + "(void) { return " + number + "; }\n";
    };
    const auto num_in = std::to_string(f.n_in()), num_out = std::to_string(f.n_out());
    std::string text = count("_n_in", num_in) + count("_n_out", num_out) + count("_room", std::to_string(callee.room));
    text += names_and_patterns(f);
    text += begin + "int " + name + "_num_lanes(void) { return MBOCP_LANES; }\n";
    std::string inputs = "const V* const a[]={";
    int next = 0;
    for (const int size : callee.input_sizes) inputs += "m+" + std::to_string(next) + ',', next += size + 1;
    inputs += "0};\n";
    text += begin + "int " + name + "_in_lanes(double* memory) {\nV* m=(V*)memory;\n" + inputs + callee.name + "(a,m+" +
            after_inputs + ",m+" + after_outputs + ");\nreturn 0;\n}\n";
    text +=
        begin + "int " + name +
        "_work(casadi_int* sz_arg, casadi_int* sz_res, casadi_int* sz_iw, casadi_int* sz_w) {\nif (sz_arg) *sz_arg=" +
        num_in + ";\nif (sz_res) *sz_res=" + num_out + ";\nif (sz_iw) *sz_iw=0;\nif (sz_w) *sz_w=MBOCP_LANES*(" +
        after_outputs + '+' + std::to_string(callee.room) + "+1);\nreturn 0;\n}\n";
    text += begin + "int " + name +
            "(const double** arg, double** res, casadi_int* iw, double* w, int mem) {\nstatic const int in[]={" +
            list_of(sizes_in) + "}, out[]={" + list_of(sizes_out) + "};\nV *m=mbocp_first_place(w), *x=m, *y=m+" +
            after_inputs + ";\nint i, j;\n(void)iw, (void)mem;\nfor (i=0; i<" + num_in +
            "; x+=in[i++]+1)\nfor (j=0; j<in[i]; ++j) { const double one=arg[i]? arg[i][j] : 0.; "
            "x[j]=mbocp_all(one); }\n{\n" +
            inputs + callee.name + "(a,y,m+" + after_outputs + ");\n}\nfor (i=0; i<" + num_out +
            "; y+=out[i++])\nif (res[i]) for (j=0; j<out[i]; ++j) res[i][j]=mbocp_first(y[j]);\nreturn 0;\n}\n";
    return text;
}

}  // namespace

std::optional<CSource> write_c(const casadi::Function& f) {
    if (!is_plain(f)) return std::nullopt;
    CWriter writer(f.name());
    try {
        const Callee callee = writer.write(f);
        return CSource{std::move(writer.functions), entries_of(f, callee)};
    } catch (const Unknown&) {
        return std::nullopt;
    }
}

}  // namespace mbocp
