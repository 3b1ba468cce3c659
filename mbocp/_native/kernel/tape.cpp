#include "tape.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <type_traits>

#include "dense.hpp"

// Sine and cosine of several numbers at once, as generated C has them.
#define MBOCP_LANES 4
#include "../../programme/lanes.h"

namespace mbocp {
namespace {

// Stages of a call: more of them share the cost of an instruction, until their numbers leave the processor's cache.
constexpr int preferred_lanes = 32, fewest_lanes = 8;
constexpr std::size_t cache = std::size_t(2) << 20;  // bytes of the second level, nearly

template <class Sine>
void apply(const double* x, double* f, int n, Sine function) {
    constexpr int width = sizeof(mbocp_lanes) / sizeof(double);
    mbocp_lanes v;
    for (; n >= width; n -= width, x += width, f += width) {
        std::memcpy(&v, x, sizeof v);
        v = function(v);
        std::memcpy(f, &v, sizeof v);
    }
}

struct One {
    using Vec = double;
};
struct Four {
    using Vec = dense::Vec;
};

// Whether a number is that of every lane, as numbers that choose are as a rule.
bool all_are(const double* numbers, int n) {
    bool same = true;
    for (int k = 1; k < n; ++k) same &= numbers[k] == numbers[0];
    return same;
}

// The place in a list that a number chooses; null beyond its ends.
template <class At>
double* chosen(const std::int32_t* list, double number, At at) {
    return number >= 0.0 && number < *list ? at(list[1 + static_cast<std::int32_t>(number)]) : nullptr;
}

// All instructions for `Blocks` times four lanes of each place; one number, where Blocks is 0.
template <int Blocks>
void execute(const Tape& tape, double* memory, int stride) {
    using Vec = typename std::conditional_t<Blocks == 0, One, Four>::Vec;
    constexpr int count = std::max(Blocks, 1), width = sizeof(Vec) / sizeof(double);
    const auto at = [=](std::int32_t place) { return memory + static_cast<std::size_t>(place) * stride; };
    for (const Instruction& i : tape.code) {
        double* const to = at(i.to);
        const double *const a = at(i.a), *const b = at(i.b);
        const auto each = [&](auto value) {
            for (int k = 0; k < count; ++k) {
                Vec v;
                if constexpr (Blocks == 0)
                    v = value(a[0], b[0], [&] { return at(i.c)[0]; });
                else
                    v = value(dense::load(a + k * width), dense::load(b + k * width),
                              [&] { return dense::load(at(i.c) + k * width); });
                if constexpr (Blocks == 0)
                    to[0] = v;
                else
                    dense::store(to + k * width, v);
            }
        };
        const auto truth = [&](auto compare) {
            for (int k = 0; k < count * width; ++k) to[k] = compare(a[k], b[k]) ? 1.0 : 0.0;
        };
        switch (i.operation) {
        case Operation::copy:
            each([](Vec x, Vec, auto) { return x; });
            break;
        case Operation::negate:
            each([](Vec x, Vec, auto) { return -x; });
            break;
        case Operation::add:
            each([](Vec x, Vec y, auto) { return x + y; });
            break;
        case Operation::subtract:
            each([](Vec x, Vec y, auto) { return x - y; });
            break;
        case Operation::multiply:
            each([](Vec x, Vec y, auto) { return x * y; });
            break;
        case Operation::divide:
            each([](Vec x, Vec y, auto) { return x / y; });
            break;
        case Operation::invert:
            each([](Vec x, Vec, auto) { return 1.0 / x; });
            break;
        case Operation::multiply_add:
            each([](Vec x, Vec y, auto z) { return x * y + z(); });
            break;
        case Operation::multiply_subtract:
            each([](Vec x, Vec y, auto z) { return x * y - z(); });
            break;
        case Operation::subtract_product:
            each([](Vec x, Vec y, auto z) { return z() - x * y; });
            break;
        case Operation::square_root:
            for (int k = 0; k < count * width; ++k) to[k] = std::sqrt(a[k]);
            break;
        case Operation::absolute:
            for (int k = 0; k < count * width; ++k) to[k] = std::abs(a[k]);
            break;
        case Operation::sine:
            if constexpr (Blocks == 0)
                to[0] = std::sin(a[0]);
            else
                apply(a, to, count * width, [](mbocp_lanes x) { return mbocp_sin(x); });
            break;
        case Operation::cosine:
            if constexpr (Blocks == 0)
                to[0] = std::cos(a[0]);
            else
                apply(a, to, count * width, [](mbocp_lanes x) { return mbocp_cos(x); });
            break;
        case Operation::less:
            truth([](double x, double y) { return x < y; });
            break;
        case Operation::at_most:
            truth([](double x, double y) { return x <= y; });
            break;
        case Operation::equal:
            truth([](double x, double y) { return x == y; });
            break;
        case Operation::unequal:
            truth([](double x, double y) { return x != y; });
            break;
        case Operation::is_false:
            truth([](double x, double) { return x == 0.0; });
            break;
        case Operation::where:
            for (int k = 0; k < count * width; ++k) to[k] = a[k] != 0.0 ? b[k] : 0.0;
            break;
        case Operation::choose:
            for (int k = 0; k < count * width; ++k) {
                const double* from = chosen(tape.lists.data() + i.b, a[k], at);
                if (from && all_are(a, count * width)) {
                    std::memcpy(to, from, sizeof(double) * count * width);
                    break;
                }
                to[k] = from ? from[k] : std::numeric_limits<double>::quiet_NaN();
            }
            break;
        case Operation::add_chosen:
            for (int k = 0; k < count * width; ++k)
                if (double* sum = chosen(tape.lists.data() + i.b, a[k], at)) sum[k] += at(i.c)[k];
            break;
        case Operation::other:
            tape.other(i.c, a, b, to, count * width);
            break;
        }
    }
}

class Taped final : public StageFunction {
public:
    explicit Taped(std::shared_ptr<const Tape> tape) : tape_(std::move(tape)) {
        input_sizes = tape_->input_sizes, outputs = tape_->outputs;
        num_inputs = static_cast<int>(input_sizes.size());
        arg.resize(input_sizes.size()), res.resize(outputs.size());
        const std::size_t of_lane = sizeof(double) * static_cast<std::size_t>(tape_->num_places);
        num_lanes = preferred_lanes;
        while (num_lanes > fewest_lanes && num_lanes * of_lane > cache) num_lanes /= 2;
        begin();
    }
    Taped(const Taped& other) : StageFunction(other), tape_(other.tape_) { begin(); }
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
        execute<0>(*tape_, one_.data(), 1);
        for (std::size_t i = 0; i < outputs.size(); ++i) dense::copy(to + first[i], res[i], outputs[i].nnz());
        return true;
    }

protected:
    bool call_all(int count) override {
        count = std::min(count, num_lanes);
        double* memory = lanes_.data();
        ++tape_->num_passes;
        if (count > 16)
            execute<8>(*tape_, memory, num_lanes);
        else if (count > 8)
            execute<4>(*tape_, memory, num_lanes);
        else
            execute<2>(*tape_, memory, num_lanes);
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
    for (const Instruction& i : tape.code) {
        const bool chooses = i.operation == Operation::choose || i.operation == Operation::add_chosen;
        if (i.operation < Operation::copy || i.operation > Operation::other || !is_place(i.to) || !is_place(i.a))
            return false;
        if (chooses) {
            if (i.b < 0 || i.b >= size || (!known[i.b] && !is_list(i.b))) return false;
            known[i.b] = true;
        } else if (!is_place(i.b)) {
            return false;
        }
        if (i.operation != Operation::other && !is_place(i.c)) return false;
    }
    return true;
}

}  // namespace

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

std::shared_ptr<StageFunction> function_of(std::shared_ptr<const Tape> tape) {
    return std::make_shared<Taped>(std::move(tape));
}

}  // namespace mbocp
