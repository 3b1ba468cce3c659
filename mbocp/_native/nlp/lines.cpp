#include "lines.hpp"

#include <casadi/core/casadi_logger.hpp>
#include <mutex>
#include <string>

namespace mbocp {
namespace {

using Write = void (*)(const char*, std::streamsize, bool);

std::mutex changing;
int wanted = 0;
Write original = nullptr;
thread_local std::string waiting;

void collect(const char* text, std::streamsize size, bool is_error) {
    if (is_error) return original(text, size, is_error);
    waiting.append(text, static_cast<std::size_t>(size));
    const auto end = waiting.rfind('\n');
    if (end == std::string::npos) return;
    const std::string lines = waiting.substr(0, end + 1);
    waiting.erase(0, end + 1);
    original(lines.data(), static_cast<std::streamsize>(lines.size()), is_error);
}

}  // namespace

void begin_whole_lines() {
    const std::lock_guard lock(changing);
    if (wanted++ > 0) return;
    original = casadi::Logger::writeFun;
    casadi::Logger::writeFun = &collect;
}

void end_whole_lines() {
    const std::string rest = std::move(waiting);
    waiting.clear();
    if (!rest.empty()) original(rest.data(), static_cast<std::streamsize>(rest.size()), false);
    const std::lock_guard lock(changing);
    if (--wanted == 0) casadi::Logger::writeFun = original;
}

}  // namespace mbocp
