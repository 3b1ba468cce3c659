#include "tape.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>
#include <type_traits>

#include "dense.hpp"

namespace mbocp {
namespace {

// Stages of a call: more of them share the cost of an instruction, until their numbers leave the processor's cache.
constexpr int preferred_lanes = 32, fewest_lanes = 8;
constexpr std::size_t cache = std::size_t(2) << 20;  // bytes of the second level, nearly

void execute_in_lanes(const Passes& passes, double* memory, int num_lanes, int stride) {
#ifdef MBOCP_HAS_AVX512
    static const bool has_avx512 =
        __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    if (has_avx512) return execute_avx512(passes, memory, num_lanes, stride);
#endif
    execute(passes, memory, num_lanes, stride);
}

class Taped final : public StageFunction {
public:
    explicit Taped(std::shared_ptr<const Tape> tape) : tape_(std::move(tape)), passes_(tape_->passes()) {
        input_sizes = tape_->input_sizes, outputs = tape_->outputs;
        num_inputs = static_cast<int>(input_sizes.size());
        arg.resize(input_sizes.size()), res.resize(outputs.size());
        const std::size_t of_lane = sizeof(double) * static_cast<std::size_t>(tape_->num_places);
        num_lanes = preferred_lanes;
        while (num_lanes > fewest_lanes && num_lanes * of_lane > cache) num_lanes /= 2;
        begin();
    }
    Taped(const Taped& other) : StageFunction(other), tape_(other.tape_), passes_(other.passes_) { begin(); }
    std::shared_ptr<StageFunction> copy() const override { return std::make_shared<Taped>(*this); }
    std::string as_tape() const override { return write_tape(*tape_); }
    std::int64_t num_executed() const override {
        return tape_->num_passes * static_cast<std::int64_t>(tape_->code.size());
    }

    bool call() override {
        double* to = one_.data();
        for (int i = 0; i < num_inputs; ++i) {
            for (int k = 0; k < input_sizes[i]; ++k) to[k] = arg[i] ? arg[i][k] : 0.0;
            to += input_sizes[i] + 1;
        }
        ++tape_->num_passes;
        execute(passes_, one_.data());
        for (std::size_t i = 0; i < outputs.size(); ++i) dense::copy(to + first[i], res[i], outputs[i].nnz());
        return true;
    }

protected:
    bool call_all(int count) override {
        count = std::min(count, num_lanes);
        double* memory = lanes_.data();
        ++tape_->num_passes;
        execute_in_lanes(passes_, memory, count > 16 ? 32 : count > 8 ? 16 : 8, num_lanes);
        return true;
    }

private:
    void begin() {
        allocate();
        allocate_lanes(tape_->num_places);
        double* one = one_.allocate(static_cast<std::size_t>(tape_->num_places));
        double* lanes = lanes_.data();
        for (std::size_t k = 0; k < tape_->constants.size(); ++k) {
            const std::size_t place = static_cast<std::size_t>(tape_->first_constant) + k;
            one[place] = tape_->constants[k];
            std::fill_n(lanes + place * num_lanes, num_lanes, one[place]);
        }
    }

    std::shared_ptr<const Tape> tape_;
    Passes passes_;
    Pool one_;  // of one stage by itself
};

}  // namespace

namespace {

template <class T>
void add(std::string& bytes, const std::vector<T>& values) {
    static_assert(std::is_trivially_copyable_v<T>);
    const auto count = static_cast<std::int64_t>(values.size());
    bytes.append(reinterpret_cast<const char*>(&count), sizeof count);
    bytes.append(reinterpret_cast<const char*>(values.data()), sizeof(T) * values.size());
}

class Bytes {
public:
    explicit Bytes(std::string_view rest) : rest_(rest) {}

    template <class T>
    void take(std::vector<T>& values) {
        std::int64_t count = 0;
        copy(&count, sizeof count);
        if (count < 0 || static_cast<std::uint64_t>(count) > rest_.size() / sizeof(T)) fail();
        values.resize(static_cast<std::size_t>(count));
        copy(values.data(), sizeof(T) * values.size());
    }
    void end() const {
        if (!rest_.empty()) fail();
    }
    [[noreturn]] static void fail() { throw std::runtime_error("not a tape"); }

private:
    void copy(void* to, std::size_t size) {
        if (size > rest_.size()) fail();
        if (size) std::memcpy(to, rest_.data(), size);
        rest_.remove_prefix(size);
    }

    std::string_view rest_;
};

// Whether all places and lists of the instructions are there.
bool is_sound(const Tape& tape) {
    const auto size = static_cast<std::int64_t>(tape.lists.size());
    const auto is_place = [&](std::int32_t place) { return place >= 0 && place < tape.num_places; };
    const auto is_list = [&](std::int32_t at) {
        if (at < 0 || at >= size || tape.lists[at] < 0 || tape.lists[at] >= size - at) return false;
        return std::all_of(&tape.lists[at] + 1, &tape.lists[at] + 1 + tape.lists[at], is_place);
    };
    std::int64_t before = 1;
    for (const int n : tape.input_sizes) {
        if (n < 0) return false;
        before += n + 1;
    }
    for (const Pattern& output : tape.outputs) {
        if (output.row.size() != output.column.size()) return false;
        before += output.nnz();
    }
    const auto count = static_cast<std::int64_t>(tape.constants.size());
    if (tape.first_constant != before || before + count > tape.num_places) return false;
    if (tape.num_places > before + count + static_cast<std::int64_t>(tape.code.size())) return false;
    std::vector<bool> known(tape.lists.size(), false);
    std::size_t end = 0;  // of the instructions that one leaves out
    for (std::size_t k = 0; k < tape.code.size(); ++k) {
        const Instruction& i = tape.code[k];
        const bool skips = i.operation == Operation::skip_unless_any;
        const bool has_list = skips || i.operation == Operation::choose || i.operation == Operation::add_chosen;
        if (i.operation < Operation::copy || i.operation > Operation::other || !is_place(i.a)) return false;
        if (skips) {
            if (k < end || i.c <= 0 || static_cast<std::size_t>(i.c) >= tape.code.size() - k) return false;
            end = k + 1 + static_cast<std::size_t>(i.c);
        } else if (!is_place(i.to)) {
            return false;
        }
        if (has_list) {
            if (i.b < 0 || i.b >= size || (!known[i.b] && !is_list(i.b))) return false;
            known[i.b] = true;
        } else if (!is_place(i.b)) {
            return false;
        }
        if (i.operation != Operation::other && !skips && !is_place(i.c)) return false;
    }
    return true;
}

}  // namespace

void Tape::find_runs() {
    runs.clear();
    std::size_t skip = code.size(), first = 0;  // the last that leaves others out, and the first run of these
    const auto is_end = [&](std::size_t k) { return skip < code.size() && k == skip + 1 + code[skip].c; };
    const auto close = [&] { code[skip].to = static_cast<std::int32_t>(runs.size() - first), skip = code.size(); };
    for (std::size_t k = 0; k < code.size(); ++k) {
        const bool ends = is_end(k);
        if (ends) close();
        if (k == 0 || ends || code[k].operation != code[k - 1].operation) runs.push_back(0);
        ++runs.back();
        if (code[k].operation == Operation::skip_unless_any) skip = k, first = runs.size();
    }
    if (is_end(code.size())) close();
}

std::string write_tape(const Tape& tape) {
    std::string bytes(tape_format);
    add(bytes, tape.input_sizes);
    std::vector<int> shapes;
    for (const Pattern& output : tape.outputs) shapes.push_back(output.rows), shapes.push_back(output.columns);
    add(bytes, shapes);
    for (const Pattern& output : tape.outputs) add(bytes, output.row), add(bytes, output.column);
    add(bytes, tape.constants);
    add(bytes, tape.code);
    add(bytes, tape.lists);
    add(bytes, std::vector<int>{tape.first_constant, tape.num_places});
    return bytes;
}

std::shared_ptr<Tape> read_tape(std::string_view bytes) {
    if (bytes.substr(0, tape_format.size()) != tape_format) Bytes::fail();
    Bytes rest(bytes.substr(tape_format.size()));
    auto tape = std::make_shared<Tape>();
    std::vector<int> shapes, numbers;
    rest.take(tape->input_sizes);
    rest.take(shapes);
    for (std::size_t i = 0; i + 1 < shapes.size(); i += 2) {
        Pattern& output = tape->outputs.emplace_back();
        output.rows = shapes[i], output.columns = shapes[i + 1];
        rest.take(output.row), rest.take(output.column);
    }
    rest.take(tape->constants);
    rest.take(tape->code);
    rest.take(tape->lists);
    rest.take(numbers);
    rest.end();
    if (numbers.size() != 2) Bytes::fail();
    tape->first_constant = numbers[0], tape->num_places = numbers[1];
    if (!is_sound(*tape)) Bytes::fail();
    return tape;
}

std::shared_ptr<StageFunction> function_of(std::shared_ptr<Tape> tape) {
    tape->find_runs();
    return std::make_shared<Taped>(std::move(tape));
}

}  // namespace mbocp
