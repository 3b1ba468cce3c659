// CasADi's output in whole lines.
#pragma once

namespace mbocp {

// Solvers print an iteration in some forty pieces, and each is a call into Python. Between begin and end they are
// handed on line by line. May be nested, also by several threads.
void begin_whole_lines();
void end_whole_lines();

}  // namespace mbocp
