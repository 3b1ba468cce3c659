"""Generated C cut into pieces, so that a compiler's time grows with the length of a function and no faster.

CasADi writes a function as one block of statements, tens of thousands of them, and asks of each element that
goes in or out whether its array is there. Compilers take more than linear time for such blocks: to allocate
registers, and to tell which loads and stores may meet. Here a function becomes a row of short ones that keep
what later ones need in an array; arrays that are not there are replaced once, at the entry. Statements and
their order stay as they were but for what `mbocp.programme.rewriting` does, so results differ at most by its
round-off, and where a multiplication and an addition that stood on both sides of a cut are no longer fused.

A function with any line that is not known is left as it is. Of the others some go in lanes, see
`mbocp.programme.lanes`, with those that they call: there are then two entries, for several stages at once
and, through the same statements, for one. A function that calls others in loops, or with parts of matrices,
stays as it is, too, and may have a second form for lanes, see `mbocp.programme.composed`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from mbocp.programme import composed, lanes
from mbocp.programme.composed import Composed, read_composed
from mbocp.programme.generated import (
    CALLS,
    END,
    HEAD,
    Access,
    Call,
    Function,
    Statement,
    exported_names,
    read_function,
)
from mbocp.programme.lanes import Lanes
from mbocp.programme.pieces import Pieces
from mbocp.programme.rewriting import with_reciprocals, with_sines

_PIECE = 500  # statements; of a few hundred the calls and what is kept cost nothing that can be measured
_ZEROS, _SCRATCH, _WIDE_SCRATCH = "mbocp_zeros", "mbocp_scratch", "mbocp_wide_scratch"


def split_functions(text: str, piece: int = _PIECE, of_lanes: Lanes | None = None) -> str:
    """Generated C with its functions in pieces.

    Parameters
    ----------
    text : str
        As CasADi's code generator writes it.
    piece : int
        Statements of a piece, at most.
    of_lanes : Lanes, optional
        What goes in lanes. A function f gets the entries ``int f_in_lanes(arg, res)``, whose numbers are
        vectors on their own boundaries, and ``int f_num_lanes(void)``.

    Returns
    -------
    str
        C of the same functions: the text itself where no function is made of known lines alone.
    """
    blocks = list(_blocks(text.split("\n")))
    found = [block for block in blocks if isinstance(block, _Block)]
    plain = [block.function for block in found if block.function is not None]
    if not plain:
        return text
    exported = exported_names(text)
    wide = _Wide.of(found, exported, text, piece, of_lanes)
    first = next(
        i for i, block in enumerate(blocks) if isinstance(block, _Block) and block.function is not None
    )
    written: list[str] = []
    for i, block in enumerate(blocks):
        if i == first:
            written += lanes.header(of_lanes, wide.called) if of_lanes is not None else ()
            written += chain(
                composed.header(text, wide.largest_input) if wide.composed else (), _replacements(plain)
            )
        if isinstance(block, str):
            written.append(block)
        else:
            written += wide.write(block, exported.get(block.name), piece)
    return "\n".join(written)


@dataclass(frozen=True)
class _Block:
    """A function of the text; `function` is None where a line of it is not known."""

    name: str
    lines: Sequence[str]
    function: Function | None


def _blocks(lines: Sequence[str]) -> Iterator[str | _Block]:
    """Functions, and the lines around them."""
    known: dict[str, Function] = {}  # those that others call come first
    i = 0
    while i < len(lines):
        head = HEAD.fullmatch(lines[i])
        end = _index(lines, END, i) if head else None
        if head is None or end is None:
            yield lines[i]
            i += 1
            continue
        body = lines[i : end + 1]
        function = read_function(head[1], body[1:-1], known)
        if function is not None:
            function = known[function.name] = with_reciprocals(function)
        yield _Block(head[1], body, function)
        i = end + 1


@dataclass(frozen=True)
class _Wide:
    """What goes in lanes.

    Attributes
    ----------
    entries : dict
        Functions of known statements that are called from outside alone, by their names.
    parts : dict
        Those that composed ones call.
    inner : dict
        Those that entries, parts and others of themselves call.
    composed : dict
        Functions that call them.
    sizes : dict
        What an exported one of these asks for, by the name of the function.
    """

    entries: dict[str, Function]
    parts: dict[str, Function]
    inner: dict[str, Function]
    composed: dict[str, Composed]
    sizes: dict[str, tuple[int, int, int, int]]

    @classmethod
    def of(
        cls,
        blocks: Sequence[_Block],
        exported: dict[str, str],
        text: str,
        piece: int,
        of_lanes: Lanes | None,
    ) -> _Wide:
        """Choose what goes in lanes: what is asked for, where all that it calls can, and there is room."""
        chosen = cls({}, {}, {}, {}, {})
        if of_lanes is None:
            return chosen
        known = {block.name: block for block in blocks}
        for block in blocks:
            name = exported.get(block.name)
            if name not in of_lanes.functions:
                continue
            if block.function is not None:
                parts = _with_called(block.function, known)
                if parts is not None and of_lanes.fit(sum(_numbers(one, piece) for one in parts.values())):
                    chosen.entries[block.name] = parts.pop(block.name)
                    chosen.inner.update(parts)
                continue
            sizes, wide = composed.work_of(text, name), cls({}, {}, {}, {}, {})
            if sizes is None or not composed.fits(of_lanes.number, sizes):
                continue
            if wide._add(block, known, piece, of_lanes):
                chosen.parts.update(wide.parts)
                chosen.inner.update(wide.inner)
                chosen.composed.update(wide.composed)
                chosen.sizes[block.name] = sizes
        return chosen

    def _add(self, block: _Block, known: dict[str, _Block], piece: int, of_lanes: Lanes) -> bool:
        """Add a function and all that it calls; whether that can be."""
        if block.function is not None:
            parts = _with_called(block.function, known)
            if parts is None or not of_lanes.fit(sum(_numbers(one, piece) for one in parts.values())):
                return False
            self.parts[block.name] = parts.pop(block.name)
            self.inner.update(parts)
            return True
        found = read_composed(block.name, block.lines[1:-1])
        if found is None or not all(name in known for name in found.calls):
            return False
        self.composed[block.name] = found
        return all(self._add(known[name], known, piece, of_lanes) for name in sorted(found.calls))

    @property
    def largest_input(self) -> int:
        """Numbers of the largest input of a function that others call."""
        return max((a.size for f in self.parts.values() for a in f.inputs), default=1)

    @property
    def called(self) -> list[tuple[str, int]]:
        """Functions of the library that are called lane by lane, see `lanes.header`."""
        functions = (*self.entries.values(), *self.parts.values(), *self.inner.values())
        return [
            one for f in functions for s in f.statements if (one := lanes.one_by_one(s.value)) is not None
        ]

    @property
    def _functions(self) -> Mapping[str, Function]:
        return {**self.inner, **self.parts, **self.entries}

    def write(self, block: _Block, name: str | None, piece: int) -> Iterator[str]:
        """Lines of a function, in lanes, too, where it goes there."""
        function = self._functions.get(block.name)
        if function is not None:
            yield from _write_in_lanes(function, block.lines[0], piece)
            if block.name in self.parts:
                yield from _write_as_others(function)
            if block.name in self.entries and name is not None:
                yield from _write_entry(function, name)
        elif block.function is not None:
            yield from _write(block.function, block.lines[0], piece)
        else:
            yield from block.lines
            if block.name in self.composed:
                yield ""
                yield from self.composed[block.name].write()
            if block.name in self.sizes and name is not None:
                yield from composed.entry(block.name, name, self.sizes[block.name])


def _index(lines: Sequence[str], wanted: str, start: int) -> int | None:
    return next((i for i in range(start, len(lines)) if lines[i] == wanted), None)


def _replacements(functions: Iterable[Function]) -> Iterator[str]:
    """What stands for inputs and outputs that are not there.

    What is written there nobody reads, but each thread writes into a buffer of its own: they would disturb
    each other's caches.
    """
    inputs = max((a.size for f in functions for a in f.inputs), default=0)
    outputs = max((a.size for f in functions for a in f.outputs), default=0)
    if inputs:
        yield f"static const casadi_real {_ZEROS}[{inputs}] = {{0}};"
    if outputs:
        yield f"static __thread casadi_real {_SCRATCH}[{outputs}];"


def _write(function: Function, head: str, piece: int) -> Iterator[str]:
    """Lines of the pieces, and of a function with the old head that calls them."""
    pieces = Pieces.of(function, piece)
    yield from pieces.write("casadi_real")
    yield head
    for a in function.inputs:
        yield f"  const casadi_real* x{a.number}=arg[{a.number}]? arg[{a.number}] : {_ZEROS};"
    for a in function.outputs:
        yield f"  casadi_real* y{a.number}=res[{a.number}]? res[{a.number}] : {_SCRATCH};"
    yield from pieces.call("casadi_real", _calling)
    yield "  return 0;"
    yield END


def _calling(call: Call) -> str:
    """Line of a call of one stage."""
    inputs, outputs = dict(call.inputs), dict(call.outputs)
    given = ", ".join(inputs.get(i, "0") for i in range(max(inputs, default=0) + 1))
    wanted = ", ".join(outputs.get(i, "0") for i in range(max(outputs, default=0) + 1))
    arrays = f"const casadi_real* p[]={{{given}}}; casadi_real* r[]={{{wanted}}};"
    return f"  {{ {arrays} {call.function}(p, r, 0, 0, 0); }}"


def _calling_in_lanes(call: Call) -> str:
    """Line of a call of all lanes."""
    return f"  {call.function}_in_lanes({', '.join(array for _, array in (*call.inputs, *call.outputs))});"


def _with_called(function: Function, known: Mapping[str, _Block]) -> dict[str, Function] | None:
    """Return a function and all that it calls with a number in each lane; None where one of them cannot."""
    one = _in_lanes(function)
    if one is None:
        return None
    found = {function.name: one}
    for name in sorted(function.calls):
        called = known[name].function
        more = None if called is None else _with_called(called, known)
        if more is None:
            return None
        found |= more
    return found


def _in_lanes(function: Function) -> Function | None:
    """Return the function with a number in each lane; None where one of its values has no known form."""
    statements: list[Statement] = []
    for s in function.statements:
        is_place = s.target is None or s.value.startswith(("x", f"{CALLS}["))
        value = s.value if is_place else lanes.in_lanes(s.value)
        if value is None:
            return None
        statements.append(s._replace(value=value))
    return with_sines(replace(function, statements=tuple(statements)))


def _numbers(function: Function, piece: int) -> int:
    """Return how many numbers the function has on the stack, with copies of its inputs and outputs."""
    sizes = sum(a.size for a in (*function.inputs, *function.outputs))
    return sizes + Pieces.of(function, piece).num_kept


def _write_in_lanes(function: Function, head: str, piece: int) -> Iterator[str]:
    """Lines of the pieces, of a function of all lanes, and of one with the old head for one lane."""
    pieces, kind = Pieces.of(function, piece), lanes.KIND
    yield from pieces.write(kind)
    yield f"static void {function.name}_in_lanes({', '.join(pieces.parameters(kind))}) {{"
    yield from pieces.call(kind, _calling_in_lanes)
    yield END
    yield ""
    yield head
    for a, letter, _ in _accesses(function):
        yield f"  {kind} {letter}{a.number}[{a.size}];"
    yield "  int i;"
    for a in function.inputs:
        one = f"arg[{a.number}]? arg[{a.number}][i] : 0"
        yield f"  for (i=0; i<{a.size}; ++i) {{ const double one={one}; x{a.number}[i]=mbocp_all(one); }}"
    yield f"  {function.name}_in_lanes({', '.join(f'{x}{a.number}' for a, x, _ in _accesses(function))});"
    for a in function.outputs:
        one = f"res[{a.number}][i]=mbocp_first(y{a.number}[i])"
        yield f"  if (res[{a.number}]) for (i=0; i<{a.size}; ++i) {one};"
    yield "  return 0;"
    yield END
    yield ""


def _accesses(function: Function) -> list[tuple[Access, str, str]]:
    """Inputs and outputs, with the letters of parameters and the names of the arrays they come from."""
    inputs = [(a, "x", "arg") for a in function.inputs]
    return inputs + [(a, "y", "res") for a in function.outputs]


def _write_entry(function: Function, name: str) -> Iterator[str]:
    """Entry for all lanes of an exported function."""
    yield f"CASADI_SYMBOL_EXPORT int {name}_num_lanes(void) {{ return MBOCP_LANES; }}"
    yield f"CASADI_SYMBOL_EXPORT int {name}_in_lanes(const casadi_real** arg, casadi_real** res) {{"
    passed = (
        f"({'const ' if letter == 'x' else ''}{lanes.KIND}*){array}[{a.number}]"
        for a, letter, array in _accesses(function)
    )
    yield f"  {function.name}_in_lanes({', '.join(passed)});"
    yield "  return 0;"
    yield END


def _write_as_others(function: Function) -> Iterator[str]:
    """A function of all lanes that others call as they call plain ones; arrays may not be there."""
    yield composed.head_of(function.name)
    yield "  (void)iw; (void)w;"
    absent = {"x": composed.ZEROS, "y": _WIDE_SCRATCH}
    passed = (
        f"{array}[{a.number}]? {array}[{a.number}] : {absent[letter]}"
        for a, letter, array in _accesses(function)
    )
    outputs = max((a.size for a in function.outputs), default=0)
    if outputs:
        yield f"  static __thread {lanes.KIND} {_WIDE_SCRATCH}[{outputs}];"
    yield f"  {function.name}_in_lanes({', '.join(passed)});"
    yield "  return 0;"
    yield END
    yield ""
