// A receding horizon in C++, without Python: what `mbocp.RecedingHorizon.save` has written to a folder.
//
//     mbocp::Controller controller("folder");
//     while (true) {
//         controller.step(q, v, goal);
//         if (controller.is_good()) command(controller.control_for(0.004));
//     }
//
// Everything that runs is in the folder: compiled functions of the stages, the solver, and numbers. This header opens
// it with dlopen (link with -ldl where the C library is older than 2.34), and needs C++17. Folders are for machines
// like the one that wrote them: the same system and processor instructions. They hold code: open none that you do not
// trust.
//
// The constructor throws std::runtime_error. A step throws and allocates nothing: it says what became of it. Units are
// SI: m, rad, N, N m and their rates; configurations as in Pinocchio, quaternions as xyzw. Moves of a configuration,
// which gains answer to, are along its tangent.
#pragma once

#include <dlfcn.h>

#include <algorithm>
#include <cstddef>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

extern "C" {

// What the library in the folder offers, in C.

struct mbocp_sizes {
    int nq, nv, nu, num_steps;  // of a configuration, a velocity and the controls; steps of the horizon
    int x_stride, u_stride;     // numbers from a node's state to the next, and of a step's controls
    int gain_stride;            // and of a row of gains
    int has_target;             // whether the cost tracks a configuration
    double dt;                  // of a step of the horizon [s]
};

struct mbocp_request {
    const double* q;          // nq
    const double* v;          // nv
    const double* goal_q;     // nq, or null: as before
    const double* goal_rate;  // nv: velocity or momentum at the end, whichever the problem's goal has; or null
    const double* target_q;   // of the tracking cost: nq, or num_steps rows of these; or null
    const double* target_p;   // nv, or num_steps rows of these; or null
    int target_rows;          // 1 or num_steps
    double dt;                // since the step before [s]; NaN: a step of the horizon
    double time_limit;        // [us]; infinite: none
    int iterations;           // Newton steps at most; negative: those of the horizon
};

struct mbocp_status {
    int state, iterations;
    double increment, step_length, violation, barrier, seconds;
    const char* detail;  // what was wrong with what was given; until the next step
};

struct mbocp_controller;
}

namespace mbocp {

// Why a step ended, see docs/receding_horizon.md.
enum class State { converged, improved, out_of_time, stuck, not_finite, bad_input, moved_on };

inline const char* name_of(State state) {
    static const char* const names[] = {"converged",  "improved",  "out_of_time", "stuck",
                                        "not_finite", "bad_input", "moved_on"};
    return names[static_cast<int>(state)];
}

// What a step may change, beside where the robot is. What is left out stays as it was.
struct Request {
    const double* goal_q = nullptr;     // configuration at the end (nq)
    const double* goal_rate = nullptr;  // velocity or momentum there, whichever the problem's goal has (nv)
    const double* target_q = nullptr;   // of the tracking cost (nq), or a row for each step
    const double* target_p = nullptr;   // (nv), or a row for each step
    int target_rows = 1;
    double dt = std::numeric_limits<double>::quiet_NaN();  // since the step before [s]; default: one of the horizon
    double time_limit = std::numeric_limits<double>::infinity();  // [us]
    int iterations = -1;                                          // Newton steps at most; -1: those of the horizon
};

// What became of a step.
struct Status {
    State state = State::improved;
    int iterations = 0;       // Newton steps taken
    double increment = 0;     // norm of the last one in all unknowns
    double step_length = 0;   // part of it that was taken
    double violation = 0;     // sum of the defects of steps, end conditions and limits
    double barrier = 0;       // parameter of the limits' barrier
    double seconds = 0;       // in the solver [s]
    const char* detail = "";  // what was wrong with what was given; until the next step

    // Whether at least one Newton step was taken from the state that was given.
    bool is_good() const { return iterations > 0 && state != State::bad_input; }
};

class Controller {
public:
    // Throws std::runtime_error if the folder holds no horizon that this machine can run.
    explicit Controller(const std::string& folder)
        : lower_(numbers(folder, "effort_lower")), upper_(numbers(folder, "effort_upper")) {
        // Functions with the names of another folder's are its own: RTLD_LOCAL.
        library_ = dlopen((folder + "/libmbocp_receding.so").c_str(), RTLD_NOW | RTLD_LOCAL);
        if (!library_) throw std::runtime_error("mbocp: " + std::string(dlerror()));
        try {
            if (symbol<int (*)()>("mbocp_controller_version")() != 1)
                throw std::runtime_error("mbocp: " + folder + ": of another version than receding_horizon.hpp");
            step_ = symbol<decltype(step_)>("mbocp_controller_step");
            close_ = symbol<decltype(close_)>("mbocp_controller_close");
            const auto open = symbol<mbocp_controller* (*)(const char*, char*, int)>("mbocp_controller_open");
            const auto sizes = symbol<mbocp_sizes (*)(const mbocp_controller*)>("mbocp_controller_sizes");
            using View = const double* (*)(const mbocp_controller*);
            char words[512] = "";
            handle_ = open(folder.c_str(), words, sizeof words);
            if (!handle_) throw std::runtime_error("mbocp: " + folder + ": " + words);
            sizes_ = sizes(handle_);
            x_ = symbol<View>("mbocp_controller_x")(handle_);
            u_ = symbol<View>("mbocp_controller_u")(handle_);
            gains_ = symbol<View>("mbocp_controller_gains")(handle_);
            held_.resize(static_cast<std::size_t>(nu()));
            if (lower_.size() != held_.size() || upper_.size() != held_.size()) {
                close_(handle_);
                throw std::runtime_error("mbocp: " + folder +
                                         ": controller.txt has no limits of efforts; save the horizon again");
            }
        } catch (...) {
            dlclose(library_);
            throw;
        }
    }
    Controller(const Controller&) = delete;
    Controller& operator=(const Controller&) = delete;
    ~Controller() {
        close_(handle_);
        dlclose(library_);
    }

    int nq() const { return sizes_.nq; }
    int nv() const { return sizes_.nv; }
    int nu() const { return sizes_.nu; }
    int num_steps() const { return sizes_.num_steps; }
    double dt() const { return sizes_.dt; }  // of a step of the horizon [s]

    // Moves on in time, takes what has changed, and improves the motion from a state.
    const Status& step(const double* q, const double* v, const Request& request = {}) noexcept {
        const mbocp_request all{q,
                                v,
                                request.goal_q,
                                request.goal_rate,
                                request.target_q,
                                request.target_p,
                                request.target_rows,
                                request.dt,
                                request.time_limit,
                                request.iterations};
        const mbocp_status found = step_(handle_, &all);
        status_ = {static_cast<State>(found.state),
                   found.iterations,
                   found.increment,
                   found.step_length,
                   found.violation,
                   found.barrier,
                   found.seconds,
                   found.detail};
        return status_;
    }

    // The same towards a configuration, which the tracking cost, if there is one, compares with, too. Vectors of wrong
    // sizes are bad input.
    const Status& step(const std::vector<double>& q, const std::vector<double>& v, const std::vector<double>& goal = {},
                       Request request = {}) noexcept {
        const auto of = [](const std::vector<double>& numbers, int size) {
            return static_cast<int>(numbers.size()) == size ? numbers.data() : nullptr;
        };
        if (!goal.empty()) {
            request.goal_q = of(goal, nq());
            if (sizes_.has_target) request.target_q = request.goal_q, request.target_rows = 1;
        }
        const bool is_bad_goal = !goal.empty() && !request.goal_q;
        return step(is_bad_goal ? nullptr : of(q, nq()), of(v, nv()), request);
    }

    const Status& status() const { return status_; }
    bool is_good() const { return status_.is_good(); }

    // The prediction, which the next step overwrites. Control for the time from now on (nu):
    const double* u() const { return u_; }
    double u(int i) const { return u_[i]; }
    // Control to hold for a period [s] that is less than a step (nu), until the next call: u() is that of the middle of
    // the first step. On the line through those of the first two steps, amid the period, within limits of effort; from
    // a step on it is u(). Throws std::invalid_argument unless the period is above 0.
    const double* control_for(double period) {
        if (!(period > 0.0)) throw std::invalid_argument("mbocp: period: expected a time above 0 [s]");
        const double early = 0.5 * (1.0 - std::min(period / dt(), 1.0));
        const double* next = us(std::min(1, num_steps() - 1));
        for (std::size_t i = 0; i < held_.size(); ++i)
            held_[i] = std::min(std::max(u_[i] - early * (next[i] - u_[i]), lower_[i]), upper_[i]);
        return held_.data();
    }
    // What it answers to a deviation of the state, u + K dx: moves of q along its tangent, then of v (2 nv).
    double K(int i, int j) const { return gain(0, i, j); }
    // Configurations and velocities of the nodes 0 (now) to num_steps, controls and gains of the steps.
    double q(int node, int i) const { return q(node)[i]; }
    double v(int node, int i) const { return v(node)[i]; }
    const double* q(int node) const { return x_ + static_cast<std::ptrdiff_t>(node) * sizes_.x_stride; }
    const double* v(int node) const { return q(node) + sizes_.nq; }
    const double* us(int step) const { return u_ + static_cast<std::ptrdiff_t>(step) * sizes_.u_stride; }
    double gain(int step, int i, int j) const {
        return gains_[(static_cast<std::ptrdiff_t>(step) * sizes_.u_stride + i) * sizes_.gain_stride + j];
    }

private:
    // Of a line of the folder's text file; none where it has no such line.
    static std::vector<double> numbers(const std::string& folder, const std::string& name) {
        std::ifstream file(folder + "/controller.txt");
        std::vector<double> found;
        std::string line, word;
        while (std::getline(file, line)) {
            std::istringstream words(line);
            if (!(words >> word) || word != name) continue;
            words >> word;  // how many
            while (words >> word) found.push_back(std::strtod(word.c_str(), nullptr));
            break;
        }
        return found;
    }

    template <class F>
    F symbol(const char* name) const {
        void* found = dlsym(library_, name);
        if (!found) throw std::runtime_error(std::string("mbocp: no ") + name + " in the folder's library");
        return reinterpret_cast<F>(found);
    }

    void* library_ = nullptr;
    mbocp_controller* handle_ = nullptr;
    mbocp_sizes sizes_{};
    Status status_;
    std::vector<double> lower_, upper_, held_;  // limits of controls, and that of control_for
    const double *x_ = nullptr, *u_ = nullptr, *gains_ = nullptr;
    mbocp_status (*step_)(mbocp_controller*, const mbocp_request*) = nullptr;
    void (*close_)(mbocp_controller*) = nullptr;
};

}  // namespace mbocp
