// A UR5's torques from a saved horizon, in C++ without Python. Save it, compile this, and run:
//
//     python -c "import mbocp; mbocp.RecedingHorizon('examples/receding/ur5_follow.toml').save('ur5')"
//     c++ -std=c++17 -O2 $(python -m mbocp.receding) examples/receding/controller.cpp -o controller -ldl
//     ./controller ur5
//
// The robot here is the prediction itself: it is where the horizon said it would be. Yours is measured.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <exception>
#include <mbocp/receding_horizon.hpp>
#include <vector>

int main(int count, char** arguments) {
    if (count < 2) return std::puts("give the folder of a saved horizon"), 2;
    try {
        mbocp::Controller controller(arguments[1]);
        const int nq = controller.nq(), nv = controller.nv();
        std::vector<double> q(controller.q(0), controller.q(0) + nq), v(controller.v(0), controller.v(0) + nv);
        std::vector<double> goal(q);
        for (double& angle : goal) angle += 0.3;
        double slowest = 0.0, off = 0.0;
        for (int k = 0; k < 200; ++k) {
            const auto begun = std::chrono::steady_clock::now();
            mbocp::Request request;
            request.dt = controller.dt();  // since the last step [s]
            request.time_limit = 2000.0;   // [us]
            controller.step(q, v, goal, request);
            const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begun;
            slowest = std::max(slowest, taken.count());
            if (!controller.is_good()) {
                std::printf("step %d: %s %s\n", k, mbocp::name_of(controller.status().state),
                            controller.status().detail);
            }
            // Here torques would go to the drives: controller.u(), or u + K dx for what is measured in the meantime.
            q.assign(controller.q(1), controller.q(1) + nq), v.assign(controller.v(1), controller.v(1) + nv);
            off = 0.0;
            for (int i = 0; i < nq; ++i) off = std::max(off, std::abs(q[i] - goal[i]));
        }
        std::printf("%d steps of %g s: %.2g rad from the goal; the slowest took %.3g ms\n", 200, controller.dt(), off,
                    1e3 * slowest);
    } catch (const std::exception& error) {
        return std::puts(error.what()), 1;
    }
}
