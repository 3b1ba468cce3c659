// Python's view of the kernel: typed arrays at the border, records as named attributes.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/shared_ptr.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <stdexcept>

#include "c_source.hpp"
#include "flow.hpp"
#include "newton.hpp"
#include "receding.hpp"
#include "stopping.hpp"
#include "sweeps.hpp"

#ifndef MBOCP_KERNEL_NAME
#define MBOCP_KERNEL_NAME _kernel
#endif

namespace nb = nanobind;
using namespace mbocp;
using Input = nb::ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Output = nb::ndarray<nb::numpy, double, nb::ndim<1>>;
using Released = nb::call_guard<nb::gil_scoped_release>;  // other threads of Python go on meanwhile

namespace {

// What a casadi.Function of Python holds: both modules call the same libcasadi.
const casadi::Function& function_in(nb::handle python) {
    if (!nb::isinstance(python, nb::module_::import_("casadi").attr("Function")))
        throw nb::type_error("no casadi.Function");
    const nb::object held = python.attr("this");
    const nb::int_ address(held);
    return *reinterpret_cast<const casadi::Function*>(nb::cast<std::uintptr_t>(address));
}

Numbers to_numbers(const Input& a) { return Numbers(a.data(), a.data() + a.size()); }

Programme::Parts to_parts(const std::vector<Input>& given) {
    Programme::Parts parts;
    if (given.size() != parts.size()) throw std::invalid_argument("parts: wrong number of them");
    std::transform(given.begin(), given.end(), parts.begin(), to_numbers);
    return parts;
}

Output to_array(const Numbers& values) {
    auto* copy = new Numbers(values);
    nb::capsule owner(copy, [](void* p) noexcept { delete static_cast<Numbers*>(p); });
    return Output(copy->data(), {copy->size()}, owner);
}

// An array of what is computed while other threads of Python go on.
template <class Compute>
Output computed(Compute compute) {
    Numbers values;
    {
        nb::gil_scoped_release released;
        values = compute();
    }
    return to_array(values);
}

// Numbers of the outputs, those of one stage after another; inputs have the numbers of all stages, too.
std::vector<Output> evaluate(StageFunction& f, const std::vector<Input>& inputs, int count, bool is_in_lanes) {
    if (static_cast<int>(inputs.size()) != f.num_inputs) throw std::invalid_argument("inputs: wrong number");
    for (int i = 0; i < f.num_inputs; ++i)
        if (static_cast<int>(inputs[i].size()) != count * f.input_sizes[i])
            throw std::invalid_argument("inputs: wrong length");
    std::vector<Numbers> found(f.outputs.size());
    const int num_lanes = is_in_lanes ? f.num_lanes : 1;
    const double* of_stages[most_lanes];
    for (int begin = 0; begin < count; begin += num_lanes) {
        for (int i = 0; i < f.num_inputs; ++i) {
            for (int lane = 0; lane < num_lanes; ++lane)
                of_stages[lane] = inputs[i].data() + std::min(begin + lane, count - 1) * f.input_sizes[i];
            if (num_lanes == 1)
                f.arg[i] = of_stages[0];
            else
                f.set(i, of_stages);
        }
        if (!(num_lanes == 1 ? f.call() : f.call_in_lanes(count - begin))) throw std::runtime_error("not finite");
        for (std::size_t i = 0; i < found.size(); ++i)
            for (int lane = 0; lane < std::min(num_lanes, count - begin); ++lane)
                for (int k = 0; k < f.outputs[i].nnz(); ++k)
                    found[i].push_back(num_lanes == 1 ? f.res[i][k]
                                                      : f.values(static_cast<int>(i))[k * num_lanes + lane]);
    }
    std::vector<Output> out;
    for (const Numbers& numbers : found) out.push_back(to_array(numbers));
    return out;
}

void check_length(const char* name, const Input& values, int wanted) {
    if (static_cast<int>(values.size()) != wanted)
        throw std::invalid_argument(std::string(name) + ": got " + std::to_string(values.size()) +
                                    " numbers, expected " + std::to_string(wanted));
}

FlowSteps steps_of(const Flow& flow, const Input& controls, const Input& lengths) {
    const int count = static_cast<int>(lengths.size());
    const int size = count ? static_cast<int>(controls.size()) / count : 0;
    check_length("controls", controls, count * size);
    if (flow.num_controls() ? size % flow.num_controls() : size)
        throw std::invalid_argument("controls: wrong number of coefficients");
    return {controls.data(), lengths.data(), count, size};
}

// A property that reads a copy and writes in place after a check of the length; `field` finds the vector.
template <class Field>
void vector_property(nb::class_<Programme>& c, const char* name, Field field, const char* doc) {
    c.def_prop_rw(
        name, [field](Programme& p) { return to_array(field(p)); },
        [name, field](Programme& p, const Input& value) {
            Numbers& numbers = field(p);
            check_length(name, value, static_cast<int>(numbers.size()));
            std::copy(value.data(), value.data() + value.size(), numbers.begin());
        },
        nb::for_getter(nb::rv_policy::move), doc);
}

// A property that is a view: rows of numbers that stay where they are.
template <class Shape>
void view_property(nb::class_<RecedingHorizon>& c, const char* name, Numbers RecedingHorizon::* field, Shape shape,
                   const char* doc) {
    c.def_prop_ro(
        name,
        [field, shape](nb::handle self) {
            auto& horizon = nb::cast<RecedingHorizon&>(self);
            const auto sizes = shape(horizon);
            return nb::ndarray<nb::numpy, const double>((horizon.*field).data(), sizes.size(), sizes.data(), self);
        },
        doc);
}

// A property that reads a copy.
template <class Read>
void array_property(nb::class_<Programme>& c, const char* name, Read read, const char* doc) {
    c.def_prop_ro(name, [read](const Programme& p) { return to_array(read(p)); }, nb::rv_policy::move, doc);
}

}  // namespace

NB_MODULE(MBOCP_KERNEL_NAME, module) {
    module.doc() = "Stage evaluation, sweeps and the structured factorisation of a stagewise programme.";

    module.attr("TAPE_FORMAT") = nb::str(tape_format.data(), tape_format.size());
    nb::class_<StageFunction>(module, "StageFunction")
        .def_static("from_library", &StageFunction::from_library, nb::arg("path"), nb::arg("name"))
        .def_static(
            "of", [](nb::handle function) { return StageFunction::of(function_in(function)); }, nb::arg("function"))
        .def_static("from_string", &StageFunction::from_string, nb::arg("serialised"))
        .def_static(
            "from_tape", [](const nb::bytes& tape) { return StageFunction::from_tape({tape.c_str(), tape.size()}); },
            nb::arg("tape"))
        .def("as_tape",
             [](const StageFunction& f) {
                 const std::string bytes = f.as_tape();
                 return nb::bytes(bytes.data(), bytes.size());
             })
        .def("copy", &StageFunction::copy, "The same function of its library with memory of its own.")
        .def("evaluate", &evaluate, nb::arg("inputs"), nb::arg("count"), nb::arg("is_in_lanes"),
             "Numbers of the outputs at so many stages, one stage after another, as inputs have theirs.")
        .def_prop_ro("num_executed", &StageFunction::num_executed)
        .def_ro("num_lanes", &StageFunction::num_lanes)
        .def_ro("num_inputs", &StageFunction::num_inputs);

    nb::class_<Flow>(module, "Flow")
        .def(
            "__init__",
            [](Flow* self, Function rate, const Input& numbers, std::vector<Numbers> slopes, Numbers weights,
               Numbers nodes) {
                new (self) Flow(std::move(rate), to_numbers(numbers),
                                {std::move(slopes), std::move(weights), std::move(nodes)});
            },
            nb::kw_only(), nb::arg("rate"), nb::arg("numbers"), nb::arg("slopes"), nb::arg("weights"), nb::arg("nodes"))
        .def(
            "ends",
            [](Flow& f, const Input& states, const Input& controls, const Input& lengths, int parts) {
                const FlowSteps steps = steps_of(f, controls, lengths);
                check_length("states", states, steps.count * f.state_size());
                return computed([&] { return f.ends(states.data(), steps, parts); });
            },
            nb::arg("states"), nb::arg("controls"), nb::arg("lengths"), nb::arg("parts"),
            "States after each step from its own, one after another.")
        .def(
            "chain",
            [](Flow& f, const Input& state, const Input& controls, const Input& lengths, int parts) {
                const FlowSteps steps = steps_of(f, controls, lengths);
                check_length("state", state, f.state_size());
                Numbers carried;
                return computed([&] { return f.chain(state.data(), steps, parts, nullptr, carried); });
            },
            nb::arg("state"), nb::arg("controls"), nb::arg("lengths"), nb::arg("parts"),
            "States after the steps of one flow, one after another.")
        .def(
            "track",
            [](Flow& f, const Input& state, const Input& controls, const Input& lengths, int parts,
               StageFunction& difference, const Input& planned, const Input& gains, const Input& away) {
                const FlowSteps steps = steps_of(f, controls, lengths);
                const int nv = difference.outputs.at(0).nnz(), nq = difference.input_sizes.at(0);
                const int rows = steps.count * steps.size;
                const int width = rows ? static_cast<int>(gains.size()) / rows : 0;
                check_length("state", state, f.state_size()), check_length("state", state, nq + nv);
                check_length("planned", planned, steps.count * (nq + nv)), check_length("gains", gains, rows * width);
                check_length("away", away, f.num_controls());
                if (rows && width != 2 * nv && width != 2 * nv + f.num_controls())
                    throw std::invalid_argument("gains: wrong number of columns");
                const FlowFeedback feedback{&difference, planned.data(), gains.data(), width};
                Numbers carried = to_numbers(away);
                Output states = computed([&] { return f.chain(state.data(), steps, parts, &feedback, carried); });
                return std::pair{states, to_array(carried)};
            },
            nb::arg("state"), nb::arg("controls"), nb::arg("lengths"), nb::arg("parts"), nb::arg("difference"),
            nb::arg("planned"), nb::arg("gains"), nb::arg("away"),
            "The same with feedback, and what the control at its end is away from its plan.");

    module.def(
        "write_c",
        [](nb::handle function) -> std::optional<std::pair<std::vector<std::string>, std::string>> {
            std::optional<CSource> found = write_c(function_in(function));
            if (!found) return std::nullopt;
            return std::pair{std::move(found->functions), std::move(found->entries)};
        },
        nb::arg("function"));

    nb::class_<Kind>(module, "Kind")
        .def(
            "__init__",
            [](Kind* self, int nx, int ndx, int ny, int nu, int nr, Function values, Function jacobian,
               Function complete, const Input& scale_c, const Input& scale_y, const Input& scale_m,
               const Input& scale_ru, const std::vector<std::tuple<int, int, std::vector<int>>>& groups,
               Numbers turning) {
                new (self) Kind();
                self->nx = nx, self->ndx = ndx, self->ny = ny, self->nu = nu, self->nr = nr;
                self->values = std::move(values), self->jacobian = std::move(jacobian);
                self->complete = std::move(complete);
                self->scale_c = to_numbers(scale_c), self->scale_y = to_numbers(scale_y);
                self->scale_m = to_numbers(scale_m), self->scale_ru = to_numbers(scale_ru);
                const auto check = [](const Numbers& v, int n, const char* name) {
                    if (static_cast<int>(v.size()) != n)
                        throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(n) + " numbers");
                };
                check(self->scale_c, self->nc(), "scale_c"), check(self->scale_y, ny, "scale_y");
                check(self->scale_m, self->nc(), "scale_m"), check(self->scale_ru, nu, "scale_ru");
                if (!turning.empty()) check(turning, ndx, "turning");
                self->turning = std::move(turning);
                for (const auto& [first, rows, columns] : groups) self->groups.push_back({first, rows, columns});
            },
            nb::kw_only(), nb::arg("nx"), nb::arg("ndx"), nb::arg("ny"), nb::arg("nu"), nb::arg("nr"),
            nb::arg("values"), nb::arg("jacobian"), nb::arg("complete"), nb::arg("scale_c"), nb::arg("scale_y"),
            nb::arg("scale_m"), nb::arg("scale_ru"),
            nb::arg("groups") = std::vector<std::tuple<int, int, std::vector<int>>>(), nb::arg("turning") = Numbers());

    nb::class_<Terminal>(module, "Terminal")
        .def(
            "__init__",
            [](Terminal* self, int ng, Function values, Function complete) {
                new (self) Terminal();
                self->ng = ng, self->values = std::move(values), self->complete = std::move(complete);
            },
            nb::kw_only(), nb::arg("ng"), nb::arg("values"), nb::arg("complete"));

    nb::class_<Trial>(module, "Trial")
        .def(
            "__init__",
            [](Trial* self, double objective, double violation) { new (self) Trial{objective, violation, true}; },
            nb::arg("objective"), nb::arg("violation"))
        .def_ro("objective", &Trial::objective)
        .def_ro("violation", &Trial::violation)
        .def_ro("finite", &Trial::finite)
        .def_prop_ro("is_feasible", &Trial::is_feasible);

    nb::class_<Evaluation, Trial>(module, "Evaluation")
        .def_ro("cost", &Evaluation::cost)
        .def_ro("residual", &Evaluation::residual)
        .def_ro("primal", &Evaluation::primal)
        .def_ro("dual", &Evaluation::dual)
        .def_ro("worst", &Evaluation::worst)
        .def_ro("worst_stage", &Evaluation::worst_stage)
        .def_ro("worst_row", &Evaluation::worst_row)
        .def_ro("barrier_error", &Evaluation::barrier_error)
        .def_ro("complementarity", &Evaluation::complementarity);

    nb::class_<Factorisation>(module, "Factorisation")
        .def_ro("negative", &Factorisation::negative)
        .def_ro("smallest_pivot", &Factorisation::smallest_pivot)
        .def_ro("end_condition", &Factorisation::end_condition)
        .def_ro("ok", &Factorisation::ok)
        .def_ro("bad_stage", &Factorisation::bad_stage)
        .def_ro("augmentation", &Factorisation::augmentation);

    nb::class_<Direction>(module, "Direction")
        .def_ro("increment", &Direction::increment)
        .def_ro("turn", &Direction::turn)
        .def_ro("slope", &Direction::slope)
        .def_ro("longest", &Direction::longest)
        .def_ro("longest_dual", &Direction::longest_dual)
        .def_ro("curvature", &Direction::curvature)
        .def_ro("linear_residual", &Direction::linear_residual)
        .def_ro("finite", &Direction::finite);

    nb::class_<Verdict>(module, "Verdict")
        .def_ro("is_accepted", &Verdict::is_accepted)
        .def_ro("by_cost", &Verdict::by_cost);

    nb::class_<Filter>(module, "Filter")
        .def_static("start", &Filter::start, nb::arg("violation"), nb::arg("is_limited"))
        .def("accepts", &Filter::accepts, nb::arg("before"), nb::arg("trial"), nb::arg("slope"), nb::arg("length"))
        .def("accepts_after_relaxation", &Filter::accepts_after_relaxation, nb::arg("reference"), nb::arg("trial"))
        .def("with_corner", &Filter::with_corner, nb::arg("before"))
        .def("without_corners", &Filter::without_corners)
        .def_prop_ro("most_violation", &Filter::most_violation)
        .def_prop_ro("num_corners", &Filter::num_corners);

    nb::class_<Sizes>(module, "Sizes").def_ro("primal", &Sizes::primal).def_ro("dual", &Sizes::dual);

    nb::class_<SweepOutcome>(module, "SweepOutcome")
        .def_ro("evaluation", &SweepOutcome::evaluation)
        .def_ro("failed_stage", &SweepOutcome::failed_stage);

    nb::class_<Sweep>(module, "Sweep")
        .def_ro("ok", &Sweep::ok)
        .def_ro("failed_stage", &Sweep::failed_stage)
        .def_ro("iterations", &Sweep::iterations)
        .def_ro("residual", &Sweep::residual);

    nb::class_<Programme> programme(module, "Programme");
    programme.def(nb::init<int, Kind, Terminal, Function, Function, int>(), nb::arg("num_stages"), nb::arg("kind"),
                  nb::arg("terminal"), nb::arg("retract"), nb::arg("difference"), nb::arg("num_threads") = 1);
    vector_property(programme, "x", [](Programme& p) -> Numbers& { return p.iterate.x; }, "States, node after node.");
    vector_property(
        programme, "y", [](Programme& p) -> Numbers& { return p.iterate.y; }, "Algebraic unknowns, stage after stage.");
    vector_property(
        programme, "u", [](Programme& p) -> Numbers& { return p.iterate.u; }, "Controls, stage after stage.");
    vector_property(
        programme, "m", [](Programme& p) -> Numbers& { return p.iterate.m; },
        "Multipliers of the stages' rows, stage after stage.");
    vector_property(
        programme, "eta", [](Programme& p) -> Numbers& { return p.iterate.eta; }, "Multipliers of the end condition.");
    vector_property(
        programme, "slack", [](Programme& p) -> Numbers& { return p.barrier.slack; },
        "Slacks of the limits: stage after stage, then the guards; of an equation its value.");
    vector_property(
        programme, "z_lower", [](Programme& p) -> Numbers& { return p.barrier.z_lower; },
        "Multipliers of the lower limits, not negative.");
    vector_property(
        programme, "z_upper", [](Programme& p) -> Numbers& { return p.barrier.z_upper; },
        "Multipliers of the upper limits, not negative, and of equations.");

    programme
        .def(
            "set_parameters",
            [](Programme& p, const Input& theta, const Input& rho, const Input& rho_terminal) {
                p.problem.set_parameters({theta.data(), theta.size()}, {rho.data(), rho.size()},
                                         {rho_terminal.data(), rho_terminal.size()});
            },
            nb::arg("theta"), nb::arg("rho"), nb::arg("rho_terminal"))
        .def("evaluate", &Programme::evaluate, nb::arg("share") = 1.0, Released())
        .def(
            "factorise", [](Programme& p, double shift, double augment) { return p.riccati.factorise(shift, augment); },
            nb::arg("shift") = 0.0, nb::arg("augment") = 0.0, Released())
        .def(
            "solve", [](Programme& p, int refinements) { return p.riccati.solve(refinements); },
            nb::arg("refinements") = 1, Released())
        .def("learn", &Programme::learn, Released())
        .def(
            "solve_for",
            [](Programme& p, const std::vector<Input>& rhs, int count) {
                const Programme::Parts parts = to_parts(rhs);
                const Programme::Solved found = [&] {
                    nb::gil_scoped_release released;
                    return p.solve_for(parts, count);
                }();
                std::vector<Output> steps;
                for (const Numbers& part : found.parts) steps.push_back(to_array(part));
                return std::make_tuple(std::move(steps), to_array(found.of_start), found.left, to_array(found.apart),
                                       to_array(found.largest));
            },
            nb::arg("rhs"), nb::arg("count"))
        .def("factorise_well", &factorise_well, nb::arg("shift"), nb::arg("augmentation"), Released())
        .def("correct", &Programme::correct, nb::arg("alpha"), Released())
        .def("move", &Programme::move, nb::arg("alpha"), Released())
        .def("sizes", &Programme::sizes)
        .def("trial", &Programme::trial, nb::arg("alpha"), Released())
        .def("accept", &Programme::accept, nb::arg("alpha"), nb::arg("alpha_limits") = 1.0)
        .def("simulate", &Programme::simulate, nb::arg("tolerance"), nb::arg("max_iterations"), nb::arg("warm") = false,
             nb::arg("feedback") = false, nb::arg("compensated") = false, Released())
        .def("gradient", &Programme::gradient, nb::arg("auxiliary") = false, nb::arg("feedback") = false, Released())
        .def("sweep", &sweep, nb::arg("auxiliary"), nb::arg("feedback"), Released())
        .def("find_end_multiplier", &find_end_multiplier, nb::arg("auxiliary"), nb::arg("feedback"), Released())
        .def(
            "end_sensitivity",
            [](Programme& p, bool feedback) {
                return computed([&] { return p.adjoint_sweep.end_sensitivity(feedback); });
            },
            nb::arg("feedback") = false, nb::rv_policy::move)
        .def(
            "reduced_hessian",
            [](Programme& p, double shift) { return computed([&] { return p.reduced_hessian(shift); }); },
            nb::arg("shift") = 0.0, nb::rv_policy::move)
        .def(
            "gains", [](const Programme& p) { return to_array(p.gains()); }, nb::rv_policy::move)
        .def_prop_ro("num_stages", [](const Programme& p) { return p.problem.N; })
        .def_prop_ro("num_end_conditions", [](const Programme& p) { return p.problem.ng; })
        .def_prop_ro("num_threads", [](const Programme& p) { return p.problem.crew().size(); })
        .def_prop_ro("num_shared", [](const Programme& p) { return p.problem.crew().num_shared(); })
        .def_prop_ro("num_bytes", [](const Programme& p) { return p.data.num_bytes(); });

    programme
        .def(
            "set_limits",
            [](Programme& p, const Input& x_lower, const Input& x_upper, const Input& u_lower, const Input& u_upper,
               const Input& path_lower, const Input& path_upper, Function path, Function path_values, int num_guards,
               Function guard) {
                p.barrier.set_limits({to_numbers(x_lower), to_numbers(x_upper), to_numbers(u_lower),
                                      to_numbers(u_upper), to_numbers(path_lower), to_numbers(path_upper), num_guards},
                                     std::move(path), std::move(path_values), std::move(guard));
            },
            nb::kw_only(), nb::arg("x_lower"), nb::arg("x_upper"), nb::arg("u_lower"), nb::arg("u_upper"),
            nb::arg("path_lower"), nb::arg("path_upper"), nb::arg("path").none(), nb::arg("path_values").none(),
            nb::arg("num_guards"), nb::arg("guard").none())
        .def(
            "start_limits",
            [](Programme& p, double barrier, double inside) { p.barrier.start(p.iterate, barrier, inside); },
            nb::arg("barrier"), nb::arg("inside") = 1e-2, Released())
        .def("weigh", &Programme::weigh, nb::arg("barrier"), Released())
        .def("aim", &Programme::aim, nb::arg("barrier"), nb::arg("is_curved") = false, Released())
        .def_prop_ro("barrier", [](const Programme& p) { return p.barrier.parameter(); })
        .def_prop_ro("num_limits", [](const Programme& p) { return p.barrier.limits().num_inequalities(); });
    programme.def("first_barrier", &first_barrier, Released())
        .def("round_off", &round_off)
        .def("round_off_of_terms", &round_off_of_terms, nb::arg("evaluation"), Released())
        .def("relative_increment", &relative_increment)
        .def("has_a_say", &has_a_say, nb::arg("dual"), Released())
        .def(
            "is_resolved",
            [](const Programme& p, double primal, double dual, double increment, double tolerance) {
                return is_resolved(p, primal, dual, increment, tolerance);
            },
            nb::arg("primal"), nb::arg("dual"), nb::arg("increment"), nb::arg("tolerance"));
    module.def(
        "is_at_rest",
        [](double residual, double allowed, double coming, double relative, double tolerance) {
            return is_at_rest(residual, allowed, coming, relative, tolerance);
        },
        nb::arg("residual"), nb::arg("allowed"), nb::arg("coming"), nb::arg("relative"), nb::arg("tolerance"));
    module.def("relative_residual", &relative_residual, nb::arg("allowed"), nb::arg("primal"), nb::arg("dual"),
               nb::arg("tolerance"));
    array_property(
        programme, "limit_multipliers", [](const Programme& p) { return p.barrier.multipliers(); },
        "Multipliers of the limits, positive where an upper one is active: rows of the stages, then guards.");

    array_property(programme, "dx", [](const Programme& p) { return p.riccati.direction().dx; }, "Step in the states.");
    array_property(
        programme, "dy", [](const Programme& p) { return p.riccati.direction().dy; }, "In the algebraic unknowns.");
    array_property(programme, "du", [](const Programme& p) { return p.riccati.direction().du; }, "In the controls.");
    array_property(
        programme, "dm", [](const Programme& p) { return p.riccati.direction().dm; }, "In the stages' multipliers.");
    array_property(
        programme, "deta", [](const Programme& p) { return p.riccati.direction().deta; },
        "In the end condition's multipliers.");
    array_property(
        programme, "costates", [](const Programme& p) { return p.data.costates(); },
        "Derivatives of the Lagrangian's later part in the nodes' states.");
    array_property(
        programme, "control_gradient", [](const Programme& p) { return p.data.control_gradient(); },
        "grad_u H of every stage, in the reported scaling.");
    array_property(
        programme, "control_scale", [](const Programme& p) { return p.data.control_scale(); },
        "Its factor from the derivative of the Lagrangian.");
    array_property(
        programme, "end_condition", [](const Programme& p) { return p.data.end.g; }, "Value of the end condition.");
    array_property(
        programme, "sigma", [](const Programme& p) { return p.adjoint_sweep.sigma; },
        "sigma of the auxiliary adjoint, stage after stage.");
    array_property(
        programme, "A", [](const Programme& p) { return p.adjoint_sweep.A; },
        "A of the auxiliary adjoint, a column for each end condition.");

    nb::enum_<Status>(module, "Status")
        .value("converged", Status::converged)
        .value("max_iterations", Status::max_iterations)
        .value("diverged", Status::diverged)
        .value("singular", Status::singular)
        .value("line_search_failed", Status::line_search_failed);

    nb::class_<NewtonState>(module, "NewtonState")
        .def_ro("native", &NewtonState::programme)
        .def_ro("evaluation", &NewtonState::evaluation)
        .def_ro("filter", &NewtonState::filter)
        .def_ro("iteration", &NewtonState::iteration)
        .def_ro("increment", &NewtonState::increment)
        .def_prop_ro("next_increment", &NewtonState::next_increment)
        .def_ro("step_length", &NewtonState::step_length)
        .def_ro("regularisation", &NewtonState::regularisation)
        .def_ro("augmentation", &NewtonState::augmentation)
        .def_ro("at_minimum", &NewtonState::at_minimum)
        .def_ro("still", &NewtonState::still)
        .def_ro("barrier", &NewtonState::barrier)
        .def_ro("least_barrier", &NewtonState::least_barrier)
        .def_prop_ro("may_stop", &NewtonState::may_stop)
        .def_prop_ro("is_free", &NewtonState::is_free)
        .def_prop_ro("is_relaxed", [](const NewtonState& s) { return s.reference.has_value(); })
        .def_ro("factorisations", &NewtonState::factorisations)
        .def_ro("corrections", &NewtonState::corrections)
        .def_ro("failure", &NewtonState::failure)
        .def_ro("failed_stage", &NewtonState::failed_stage);

    nb::class_<Newton>(module, "Newton")
        .def(
            "__init__",
            [](Newton* self, double tolerance, int max_iterations, double control_weight, bool is_careful,
               double rough) { new (self) Newton({tolerance, max_iterations, control_weight, is_careful, rough}); },
            nb::kw_only(), nb::arg("tolerance"), nb::arg("max_iterations"), nb::arg("control_weight"),
            nb::arg("is_careful"), nb::arg("rough"))
        .def("begin", &Newton::begin, nb::arg("native"), nb::arg("augmentation"), Released())
        .def("resume", &Newton::resume, nb::arg("native"), nb::arg("augmentation"), nb::arg("barrier"),
             nb::arg("is_free"), Released())
        .def("step", &Newton::step, nb::arg("state"), Released())
        .def("status", &Newton::status, nb::arg("state"), Released())
        .def("run", &Newton::run, nb::arg("state"), Released())
        .def("is_near", &Newton::is_near, nb::arg("state"))
        .def("last_barrier", &Newton::last_barrier, nb::arg("native"))
        .def(
            "update_barrier", [](const Newton& n, NewtonState s) { return n.update_barrier(s), s; }, nb::arg("state"))
        .def(
            "fix_barrier", [](const Newton& n, NewtonState s) { return n.fix_barrier(s), s; }, nb::arg("state"))
        .def("raise_barrier", [](const Newton& n, NewtonState s) { return n.raise_barrier(s), s; }, nb::arg("state"));

    nb::enum_<Outcome>(module, "Outcome")
        .value("converged", Outcome::converged)
        .value("improved", Outcome::improved)
        .value("out_of_time", Outcome::out_of_time)
        .value("stuck", Outcome::stuck)
        .value("not_finite", Outcome::not_finite)
        .value("bad_state", Outcome::bad_state)
        .value("moved_on", Outcome::moved_on);

    nb::class_<Care>(module, "Care")
        .def_static("bold", &Care::bold)
        .def_static("careful", &Care::careful)
        .def_ro("min_step", &Care::min_step)
        .def_ro("patience", &Care::patience)
        .def("larger_shift", &Care::larger_shift, nb::arg("shift"), nb::arg("least"))
        .def("regrown_shift", &Care::regrown_shift, nb::arg("shift"), nb::arg("last"), nb::arg("least"))
        .def("next_shift", &Care::next_shift, nb::arg("shift"), nb::arg("length"), nb::arg("contraction"),
             nb::arg("least"));

    nb::class_<HorizonStatus>(module, "HorizonStatus")
        .def_ro("outcome", &HorizonStatus::outcome)
        .def_ro("iterations", &HorizonStatus::iterations)
        .def_ro("increment", &HorizonStatus::increment)
        .def_ro("length", &HorizonStatus::length)
        .def_ro("violation", &HorizonStatus::violation)
        .def_ro("objective", &HorizonStatus::objective)
        .def_ro("barrier", &HorizonStatus::barrier)
        .def_ro("shift", &HorizonStatus::shift)
        .def_ro("seconds", &HorizonStatus::seconds);

    nb::class_<RecedingHorizon> horizon(module, "RecedingHorizon");
    horizon
        .def(
            "__init__",
            [](RecedingHorizon* self, Programme& programme, double tolerance, double barrier, double shift_unit,
               double augmentation) {
                new (self) RecedingHorizon(programme, {tolerance, barrier, shift_unit, augmentation});
            },
            nb::arg("programme"), nb::kw_only(), nb::arg("tolerance"), nb::arg("barrier"), nb::arg("shift_unit"),
            nb::arg("augmentation"), nb::keep_alive<1, 2>())
        .def(
            "step",
            [](RecedingHorizon& h, const Input& state, double steps, int iterations, double time_limit) {
                if (state.size() > h.state_size())
                    throw std::invalid_argument("state: got " + std::to_string(state.size()) +
                                                " numbers, expected at most " + std::to_string(h.state_size()));
                return h.step(state.data(), static_cast<int>(state.size()), steps, iterations, time_limit);
            },
            nb::arg("state"), nb::arg("steps"), nb::arg("iterations"), nb::arg("time_limit"));
    horizon.def_prop_ro(
        "memory",
        [](const RecedingHorizon& h) {
            const HorizonMemory m = h.memory();
            return std::vector<double>{m.shift, m.augmentation, m.barrier, m.least_barrier, m.duration};
        },
        "Shift of the Hessian, weight of the end condition, barrier parameter and the least, seconds of a Newton "
        "step.");
    using Sizes = std::vector<std::size_t>;
    view_property(
        horizon, "x", &RecedingHorizon::x,
        [](const RecedingHorizon& h) { return Sizes{h.num_stages() + 1, h.state_size()}; }, "States of the nodes.");
    view_property(
        horizon, "u", &RecedingHorizon::u,
        [](const RecedingHorizon& h) { return Sizes{h.num_stages(), h.num_controls()}; }, "Controls of the steps.");
    view_property(
        horizon, "gains", &RecedingHorizon::gains,
        [](const RecedingHorizon& h) { return Sizes{h.num_stages(), h.num_controls(), h.tangent_size()}; },
        "What the controls answer to deviations of the states before, of the last factorisation.");
}
