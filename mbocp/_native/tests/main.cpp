#include "checks.hpp"

// Runs all tests: a line for each, with what is wrong below it.
int main() {
    using namespace mbocp::tests;
    for (const Test& test : all_tests()) {
        const std::size_t before = failures().size();
        test.run();
        std::printf("%s %s\n", failures().size() == before ? "passed" : "FAILED", test.name);
        for (std::size_t i = before; i < failures().size() && i < before + 10; ++i)
            std::printf("    %s\n", failures()[i].c_str());
    }
    return failures().empty() ? 0 : 1;
}
