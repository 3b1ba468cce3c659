"""Generated functions that call others, in loops and with parts of arrays, for several stages at once.

CasADi writes such a function line by line: copies, sums and products of arrays, columns chosen by numbers,
calls. With vectors in the place of numbers every line serves all stages; what it calls goes in lanes, too.
Numbers that choose columns are those of the first lane. Where lanes disagree the function says so by what it
returns, and its entry calls the plain one lane by lane. A line of another form leaves the function alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from mbocp.programme.lanes import KIND

_HEADER = Path(__file__).with_name("composed.h")
SOURCES = (_HEADER,)  # of the C, beside this module
_MOST = 64 << 20  # bytes of what a thread keeps for a function
ZEROS = "mbocp_wide_zeros"  # stands for inputs that are not there

_ARRAY = r"wr?\d+"
_STEP = rf"\w\w={_ARRAY}(?:\+\d+)?"
_LOOP = r"for \(i=0(?:, \w\w=wr?\d+)*; i<\d+; \+\+i\) "
_STRIDE = rf"for \((?:{_STEP}, )*{_STEP}; \w\w!={_ARRAY}\+\d+; \w\w\+=\d+\) "
_INNER = r"for \(ct=cs\+\d+; ct!=cs\+\d+; ct\+=\d+\) "
_COLUMNS = (
    rf"(for \((?:{_STEP}, )*{_STEP}; cr!={_ARRAY}\+\d+; \+\+cr\)) for \(j=\(int\) \*cr, k=0;k<(\d+);k\+=1\) "
)

_AS_IT_IS = tuple(
    map(
        re.compile,
        (
            r"casadi_int i(?:, j)?(?:, k)?;",
            r"(arg|res)1 = \1\+\d+;",
            r"for \(i=0; i<\d+; \+\+i\) (arg|res)1\[i\]=\1\[i\];",
            r"for \(i=0; ?i<\d+; ?\+\+i\) ?\{",
            r"for \(j=0; ?j<\d+; ?\+\+j\) ?\{",
            r"\}",
            r"if \((?P<a>arg|res)1\[(?P<k>\d+)\]\) (?P=a)1\[(?P=k)\]\+=\d+;",
            rf"(arg|res)1\[\d+\]=(?:{_ARRAY}|0);",
            rf"{_ARRAY} ?=(?: ?{_ARRAY})(?: ?\+ ?\d+)?;",
            rf"{_ARRAY} ?\+= ?\d+;",
            r"rr=w\d+;",
            rf"{_LOOP}\*rr\+\+ = \*cs\+\+;",
            rf"{_LOOP}\*rr\+\+ = \((?:2\.\*|-) ?\*cs\+\+ \);",
            rf"{_LOOP}for \(j=0; j<\d+; \+\+j\) rr\[i\+j\*\d+\] = \*cs\+\+;",
            rf"{_LOOP}\(\*rr\+\+\) (?:[+*-]?=) \(\*cs\+\+\);",
            rf"{_LOOP}\(\*rr\+\+\)  ?= ?\((?:{_ARRAY}|\(\*cs\+\+\))[-+*](?:{_ARRAY}|\(\*c[rs]\+\+\))\);",
            rf"{_STRIDE}\*rr\+\+ = \*cs;",
            rf"{_STRIDE}{_INNER}\*rr\+\+ = \*ct;",
            rf"{_ARRAY}\[j\] \+= {_ARRAY}\[j\+i\*\d+\];",
            r"return 0;",
        ),
    )
)
_DECLARED = r"[* ]*\w+(?:=(?:w|arg|res)\+\d+)?"
_DECLARATION = re.compile(
    rf"(?:const )?casadi_real {_DECLARED}(?:, {_DECLARED})*;|(?:const )?casadi_real\* \*\w+;"
)
_CALL = re.compile(r"if \((\w+)\((arg1?), (res1?), iw, w, 0\)\) return 1;")
# Loop over columns that all lanes agree on.
_BY_COLUMN = r"\1 if (!mbocp_agree(*cr)) return 1; else for (j=(int) mbocp_first(*cr), k=0;k<\2;k+=1)"
# Lines with a number in each lane, of the parts of plain ones.
_IN_LANES = tuple(
    (re.compile(form), wide)
    for form, wide in (
        (r"(w\d+) = (-?[\d.e+-]+);", r"\1 = mbocp_all(\2);"),
        (rf"({_LOOP}\*rr\+\+ = )floor\( \*cs\+\+ \);", r"\1mbocp_wide_floor(*cs++);"),
        (
            rf"({_ARRAY}) = arg\[(\d+)\] \? arg\[\2\](\+\d+)? : casadi_zeros;",
            rf"\1 = arg[\2] ? arg[\2]\3 : {ZEROS};",
        ),
        (_CALL.pattern, r"if (\1_wide(\2, \3, iw, w)) return 1;"),
        (
            r"((?:if \(res\[\d+\]\) )?)casadi_(copy|clear|trans)\(([\w\[\]+, ]+)\);",
            r"\1mbocp_wide_\2(\3);",
        ),
        (
            rf"{_COLUMNS}\{{ i=k\+j; \*rr\+\+ = i>=0 && i<(\d+) \? (w\d+)\[i\] : casadi_nan; \}}",
            rf"{_BY_COLUMN} {{ i=k+j; *rr++ = i>=0 && i<\3 ? \4[i] : mbocp_all(casadi_nan); }}",
        ),
        (
            rf"{_COLUMNS}\{{ i=k\+j; if \(i>=0 && i<(\d+)\) (w\d+)\[i\] \+= \*cs; cs\+\+; \}}",
            rf"{_BY_COLUMN} {{ i=k+j; if (i>=0 && i<\3) \4[i] += *cs; cs++; }}",
        ),
    )
)
_COMMENT = re.compile(r"/\* .* \*/")

_ZEROS = re.compile(r"^static const casadi_real casadi_zeros\[(\d+)\]", re.M)


@dataclass(frozen=True)
class Composed:
    """A function of known lines, with a number in each lane.

    Attributes
    ----------
    name : str
    lines : tuple of str
        Between its braces.
    calls : frozenset of str
        Names of the functions that it calls.
    """

    name: str
    lines: tuple[str, ...]
    calls: frozenset[str]

    def write(self) -> Iterator[str]:
        """Lines of the function in lanes; what it returns is not zero where lanes would have to part."""
        yield head_of(self.name)
        yield from self.lines
        yield "}"
        yield ""


def head_of(name: str) -> str:
    """First line of such a function."""
    return f"static int {name}_wide(const {KIND}** arg, {KIND}** res, casadi_int* iw, {KIND}* w) {{"


def read_composed(name: str, body: Sequence[str]) -> Composed | None:
    """Return a function from the lines between its braces; None if one of them has another form."""
    lines: list[str] = []
    calls: set[str] = set()
    if not body or body[-1] != "  return 0;":
        return None
    for line in body:
        text = line.strip()
        if _COMMENT.fullmatch(text):
            continue
        found = _wide(text)
        if found is None:
            return None
        if match := _CALL.fullmatch(text):
            calls.add(match[1])
        lines.append(line[: len(line) - len(line.lstrip())] + found)
    return Composed(name, tuple(lines), frozenset(calls))


def _wide(text: str) -> str | None:
    """A line with a number in each lane; None where its form is not known."""
    if any(form.fullmatch(text) for form in _AS_IT_IS):
        return text
    if _DECLARATION.fullmatch(text):
        return text.replace("casadi_real", KIND)
    matches = ((form.fullmatch(text), wide) for form, wide in _IN_LANES)
    return next((match.expand(wide) for match, wide in matches if match), None)


@cache
def _header_text() -> str:
    return _HEADER.read_text(encoding="ascii")


def header(text: str, most: int) -> Iterator[str]:
    """Lines before the first function, after those of `lanes.header`.

    Parameters
    ----------
    text : str
        The whole C.
    most : int
        Numbers of the largest input of a function that is called.
    """
    yield from _header_text().splitlines()
    found = _ZEROS.search(text)
    yield f"static const {KIND} {ZEROS}[{max(most, int(found[1]) if found else 1)}];"


def fits(num_lanes: int, sizes: tuple[int, int, int, int]) -> bool:
    """Whether a thread may have such an array of numbers."""
    return 8 * num_lanes * sizes[3] <= _MOST


def work_of(text: str, name: str) -> tuple[int, int, int, int] | None:
    """How many inputs, outputs, integers and numbers an exported function asks for."""
    head = rf"^CASADI_SYMBOL_EXPORT int {re.escape(name)}_work\([^)]*\) {{\n"
    sizes = "".join(rf"  if \(sz_{what}\) \*sz_{what} = (\d+);\n" for what in ("arg", "res", "iw", "w"))
    found = re.search(head + sizes, text, re.M)
    return None if found is None else (int(found[1]), int(found[2]), int(found[3]), int(found[4]))


def entry(function: str, name: str, sizes: tuple[int, int, int, int]) -> Iterator[str]:
    """Entry for all lanes of an exported function: at once, or one by one where they part."""
    num_in, num_out, num_integers, num_numbers = (max(1, size) for size in sizes)
    yield f"CASADI_SYMBOL_EXPORT casadi_int {name}_n_in(void);"
    yield f"CASADI_SYMBOL_EXPORT casadi_int {name}_n_out(void);"
    yield f"CASADI_SYMBOL_EXPORT const casadi_int* {name}_sparsity_in(casadi_int i);"
    yield f"CASADI_SYMBOL_EXPORT const casadi_int* {name}_sparsity_out(casadi_int i);"
    yield f"CASADI_SYMBOL_EXPORT int {name}_num_lanes(void) {{ return MBOCP_LANES; }}"
    yield f"CASADI_SYMBOL_EXPORT int {name}_in_lanes(const casadi_real** arg, casadi_real** res) {{"
    yield f"  static __thread {KIND} w[{num_numbers}];"
    yield f"  static __thread casadi_int iw[{num_integers}];"
    yield f"  const {KIND}* x[{num_in}];"
    yield f"  {KIND}* y[{num_out}];"
    yield "  casadi_int i;"
    yield f"  const casadi_int n={name}_n_in(), m={name}_n_out();"
    yield f"  for (i=0; i<n; ++i) x[i]=(const {KIND}*)arg[i];"
    yield f"  for (i=0; i<m; ++i) y[i]=({KIND}*)res[i];"
    yield f"  if (!{function}_wide(x, y, iw, w)) return 0;"
    one_by_one = f"{function}, {name}_sparsity_in, {name}_sparsity_out"
    rest = f"n, m, {num_in}, {num_out}, arg, res, iw, (casadi_real*)w"
    yield f"  return mbocp_one_by_one({one_by_one}, {rest});"
    yield "}"
