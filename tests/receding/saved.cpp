// Steps a saved horizon through lines of (dt, q, v, goal) and prints all that it says, with all bits.
#include <cmath>
#include <cstdio>
#include <exception>
#include <mbocp/receding_horizon.hpp>
#include <stdexcept>
#include <vector>

namespace {

bool read(std::vector<double>& numbers) {
    for (double& number : numbers)
        if (std::scanf("%lf", &number) != 1) return false;
    return true;
}

void print(double number) { std::printf(" %a", number); }

}  // namespace

int main(int, char** arguments) {
    try {
        mbocp::Controller controller(arguments[1]);
        const int nq = controller.nq(), nv = controller.nv(), nu = controller.nu(), N = controller.num_steps();
        std::vector<double> dt(1), q(nq), v(nv), goal(nq);
        while (read(dt) && read(q) && read(v) && read(goal)) {
            mbocp::Request request;
            request.dt = dt[0];
            controller.step(q, v, std::isnan(goal[0]) ? std::vector<double>() : goal, request);
            std::printf("%s", mbocp::name_of(controller.status().state));
            print(controller.status().iterations), print(controller.status().increment);
            for (int i = 0; i < nu; ++i) print(controller.u(i));
            for (int i = 0; i < nu; ++i)
                for (int j = 0; j < 2 * nv; ++j) print(controller.K(i, j));
            for (int n = 0; n <= N; ++n) {
                for (int i = 0; i < nq; ++i) print(controller.q(n, i));
                for (int i = 0; i < nv; ++i) print(controller.v(n, i));
            }
            for (const double share : {0.2, 1.0, 9.0}) {
                const double* held = controller.control_for(share * controller.dt());
                for (int i = 0; i < nu; ++i) print(held[i]);
            }
            std::printf("\n");
        }
        const std::vector<double> short_one(1, 0.0);
        controller.step(short_one, v);
        std::printf("%s: %s\n", mbocp::name_of(controller.status().state), controller.status().detail);
        try {
            controller.control_for(0.0);
        } catch (const std::invalid_argument& error) {
            std::printf("%s\n", error.what());
        }
    } catch (const std::exception& error) {
        std::printf("refused: %s\n", error.what());
    }
}
