// A horizon from a folder that `mbocp.receding.saved` has written: what `mbocp/receding_horizon.hpp` calls.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>

#include "mbocp/receding_horizon.hpp"
#include "receding.hpp"

#define MBOCP_EXPORT extern "C" __attribute__((visibility("default")))

namespace {

using mbocp::Function;
using mbocp::Numbers;

constexpr int version = 1;
constexpr double microsecond = 1e-6;  // [s]

// The numbers of a folder: lines of a name, how many, and as many in C's hexadecimal form, which has all bits.
class Table {
public:
    explicit Table(const std::string& path) {
        std::ifstream file(path);
        if (!file) throw std::runtime_error("there is no controller.txt in it");
        std::string line, name, word;
        while (std::getline(file, line)) {
            std::istringstream words(line);
            std::size_t count = 0;
            words >> name >> count;
            Numbers& numbers = numbers_[name];
            while (words >> word) numbers.push_back(std::strtod(word.c_str(), nullptr));
            if (numbers.size() != count) throw std::runtime_error("controller.txt: " + name + ": cut short");
        }
        if (integer("version") != version) throw std::runtime_error("controller.txt: of another version");
    }
    const Numbers& operator[](const std::string& name) const {
        const auto found = numbers_.find(name);
        if (found == numbers_.end()) throw std::runtime_error("controller.txt: no " + name);
        return found->second;
    }
    double number(const std::string& name) const {
        const Numbers& numbers = (*this)[name];
        if (numbers.size() != 1) throw std::runtime_error("controller.txt: " + name + ": expected one number");
        return numbers[0];
    }
    int integer(const std::string& name) const { return static_cast<int>(number(name)); }

private:
    std::map<std::string, Numbers> numbers_;
};

void fill(Numbers& to, const Numbers& from, const char* name) {
    if (to.size() != from.size()) throw std::runtime_error(std::string("controller.txt: ") + name + ": wrong length");
    std::copy(from.begin(), from.end(), to.begin());
}

// Where numbers that change are, within others; nowhere where they cannot.
struct Place {
    std::size_t first = 0, size = 0;

    Place(const Table& table, const std::string& name, std::size_t within) {
        const Numbers& range = table[name];
        if (range.empty()) return;
        first = static_cast<std::size_t>(range.at(0)), size = static_cast<std::size_t>(range.at(1)) - first;
        if (first + size > within) throw std::runtime_error("controller.txt: " + name + ": beyond the others");
    }
    bool is_there() const { return size > 0; }
};

bool are_finite(const double* numbers, std::size_t count) {
    for (std::size_t i = 0; i < count; ++i)
        if (!std::isfinite(numbers[i])) return false;
    return true;
}

std::unique_ptr<mbocp::Programme> programme_of(const Table& table, const std::string& folder) {
    const auto function = [&](const std::string& name, bool is_of_end = false) {
        return mbocp::StageFunction::from_library(folder + (is_of_end ? "/end.so" : "/stages.so"), name);
    };
    mbocp::Kind kind;
    kind.nx = table.integer("nx"), kind.ndx = table.integer("ndx"), kind.ny = table.integer("ny");
    kind.nu = table.integer("nu_all"), kind.nr = table.integer("nr");
    kind.values = function("values"), kind.jacobian = function("jacobian"), kind.complete = function("complete");
    kind.scale_c = table["scale_c"], kind.scale_y = table["scale_y"], kind.scale_m = table["scale_m"];
    kind.scale_ru = table["scale_ru"], kind.turning = table["turning"];
    mbocp::Terminal terminal;
    terminal.ng = table.integer("ng");
    terminal.values = function("terminal_values", true), terminal.complete = function("terminal_complete", true);
    auto made = std::make_unique<mbocp::Programme>(table.integer("num_steps"), kind, terminal, function("retract"),
                                                   function("difference"));
    const Numbers &theta = table["theta"], &rho = table["rho"], &end = table["rho_terminal"];
    made->problem.set_parameters({theta.data(), theta.size()}, {rho.data(), rho.size()}, {end.data(), end.size()});
    mbocp::Iterate& iterate = made->iterate;
    fill(iterate.x, table["x"], "x"), fill(iterate.y, table["y"], "y"), fill(iterate.u, table["u"], "u");
    fill(iterate.m, table["m"], "m"), fill(iterate.eta, table["eta"], "eta");
    if (table.integer("has_limits")) {
        const int guards = table.integer("num_guards");
        const bool has_path = table.integer("has_path") != 0;
        mbocp::Barrier& barrier = made->barrier;
        barrier.set_limits({table["x_lower"], table["x_upper"], table["u_lower"], table["u_upper"], table["path_lower"],
                            table["path_upper"], guards},
                           has_path ? function("path") : nullptr, has_path ? function("path_values") : nullptr,
                           guards ? function("guard", true) : nullptr);
        barrier.start(iterate, table.number("barrier"), 0.0);
        fill(barrier.slack, table["slack"], "slack");
        fill(barrier.z_lower, table["z_lower"], "z_lower"), fill(barrier.z_upper, table["z_upper"], "z_upper");
    }
    return made;
}

mbocp::HorizonSettings settings_of(const Table& table) {
    return {table.number("tolerance"), table.number("barrier_share"), table.number("shift_unit"), 0.0};
}

}  // namespace

struct mbocp_controller {
    mbocp_controller(const Table& table, const std::string& folder)
        : programme(programme_of(table, folder)), horizon(*programme, settings_of(table)), theta(table["theta"]),
          rho(table["rho"]), rho_terminal(table["rho_terminal"]), state(table["state"]),
          row(rho.size() / static_cast<std::size_t>(table.integer("num_steps"))),
          goal_q(table, "goal_q", rho_terminal.size()), goal_rate(table, "goal_rate", rho_terminal.size()),
          target_q(table, "target_q", row), target_p(table, "target_p", row), before(table, "has_before", row) {
        const mbocp::Problem& p = programme->problem;
        sizes = {table.integer("nq"), table.integer("nv"), table.integer("nu"), p.N, p.nx, p.kind().nu, p.ndx,
                 target_q.is_there(), table.number("dt")};
        iterations = table.integer("iterations");
        const Numbers& m = table["memory"];
        horizon.resume({m.at(0), m.at(1), m.at(2), m.at(3), m.at(4)});
        fill(horizon.x, table["prediction_x"], "prediction_x"), fill(horizon.u, table["prediction_u"], "prediction_u");
        fill(horizon.gains, table["gains"], "gains");
        if (state.size() != static_cast<std::size_t>(sizes.nq + sizes.nv))
            throw std::runtime_error("state: wrong length");
    }

    mbocp_status step(const mbocp_request& request) noexcept {
        words[0] = '\0';
        take_numbers(request);
        take_state(request.q, sizes.nq, 0, "q"), take_state(request.v, sizes.nv, sizes.nq, "v");
        double steps = std::isnan(request.dt) ? 1.0 : request.dt / sizes.dt, limit = request.time_limit * microsecond;
        if (!(std::isfinite(steps) && steps >= 0.0)) steps = 1.0, tell("dt: expected a time >= 0 [s]");
        if (std::isnan(limit)) limit = 0.0, tell("time_limit: expected a time [us]");
        const int count = request.iterations < 0 ? iterations : request.iterations;
        const auto found = horizon.step(state.data(), static_cast<int>(state.size()), steps, count, limit);
        if (steps > 0.0 && before.is_there() && rho[before.first] != 1.0) rho[before.first] = 1.0, pass();
        const bool is_bad = words[0] != '\0' || found.outcome == mbocp::Outcome::bad_state;
        return {is_bad ? static_cast<int>(mbocp::State::bad_input) : static_cast<int>(found.outcome),
                found.iterations,
                found.increment,
                found.length,
                found.violation,
                found.barrier,
                found.seconds,
                words};
    }

    std::unique_ptr<mbocp::Programme> programme;
    mbocp::RecedingHorizon horizon;
    mbocp_sizes sizes{};

private:
    void take_numbers(const mbocp_request& r) noexcept {
        if (!(r.goal_q || r.goal_rate || r.target_q || r.target_p)) return;
        if (r.goal_q) take(goal_q, r.goal_q, rho_terminal.data(), 1, 1, 0, "goal.q");
        if (r.goal_rate) take(goal_rate, r.goal_rate, rho_terminal.data(), 1, 1, 0, "goal: rate");
        if (r.target_q) take(target_q, r.target_q, rho.data(), r.target_rows, sizes.num_steps, row, "target.q");
        if (r.target_p) take(target_p, r.target_p, rho.data(), r.target_rows, sizes.num_steps, row, "target.p");
        pass();
    }
    // Rows of numbers, or one for all of them, to their place in each.
    void take(const Place& place, const double* from, double* to, int rows, int count, std::size_t stride,
              const char* name) noexcept {
        if (!place.is_there()) return tell(name, ": the saved problem has no place for another one");
        if (rows != 1 && rows != count) return tell(name, ": expected one row, or one for each step");
        if (!are_finite(from, place.size * static_cast<std::size_t>(rows))) return tell(name, ": not finite");
        for (int n = 0; n < count; ++n)
            std::copy_n(from + (rows == 1 ? 0 : static_cast<std::size_t>(n) * place.size), place.size,
                        to + static_cast<std::size_t>(n) * stride + place.first);
    }
    void take_state(const double* from, int size, int first, const char* name) noexcept {
        if (from && are_finite(from, static_cast<std::size_t>(size)))
            std::copy_n(from, size, state.begin() + first);
        else
            state[0] = std::nan(""), tell(name, from ? ": not finite" : ": none given, or of a wrong size");
    }
    void pass() noexcept {  // as long as they were: nothing is allocated, and nothing thrown
        programme->problem.set_parameters({theta.data(), theta.size()}, {rho.data(), rho.size()},
                                          {rho_terminal.data(), rho_terminal.size()});
    }
    void tell(const char* name, const char* what = "") noexcept {
        const std::size_t used = std::strlen(words);
        std::snprintf(words + used, sizeof words - used, "%s%s%s", used ? "; " : "", name, what);
    }

    Numbers theta, rho, rho_terminal, state;
    std::size_t row;  // numbers of a stage in rho
    Place goal_q, goal_rate, target_q, target_p, before;
    int iterations = 1;
    char words[256] = "";
};

MBOCP_EXPORT int mbocp_controller_version() { return version; }

// Null where there is none that can run: words say why.
MBOCP_EXPORT mbocp_controller* mbocp_controller_open(const char* folder, char* words, int size) {
    try {
        return new mbocp_controller(Table(std::string(folder) + "/controller.txt"), folder);
    } catch (const std::exception& error) {
        std::snprintf(words, static_cast<std::size_t>(size), "%s", error.what());
        return nullptr;
    }
}

MBOCP_EXPORT void mbocp_controller_close(mbocp_controller* controller) { delete controller; }

MBOCP_EXPORT mbocp_sizes mbocp_controller_sizes(const mbocp_controller* controller) { return controller->sizes; }

MBOCP_EXPORT mbocp_status mbocp_controller_step(mbocp_controller* controller, const mbocp_request* request) {
    return controller->step(*request);
}

MBOCP_EXPORT const double* mbocp_controller_x(const mbocp_controller* c) { return c->horizon.x.data(); }
MBOCP_EXPORT const double* mbocp_controller_u(const mbocp_controller* c) { return c->horizon.u.data(); }
MBOCP_EXPORT const double* mbocp_controller_gains(const mbocp_controller* c) { return c->horizon.gains.data(); }
