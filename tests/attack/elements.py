"""Mutations of XML: the tree of elements and attributes, then the text."""

from __future__ import annotations

import copy
from random import Random
from xml.etree import ElementTree

from .raw import EXTREMES, mutate_bytes, mutate_lines

__all__ = ["mutate_xml"]

_Element = ElementTree.Element
_WORDS = (
    *(
        "",
        " ",
        "x",
        "world",
        "universe",
        "root_joint",
        "link",
        "é",
        "\U0001f916",
        "x" * 300,
        "x" * 20_000,
        "a/b",
        "..",
    ),
    *(
        "/dev/zero",
        "/etc/passwd",
        "package://a/b.obj",
        "package://",
        "file:///dev/zero",
        "x" * 300 + ".obj",
        "%s",
        "{0}",
    ),
    *(
        "mesh.obj",
        "mesh.stl",
        "mesh.dae",
        "revolute",
        "continuous",
        "prismatic",
        "fixed",
        "floating",
        "planar",
        "ball",
    ),
)
_VECTORS = (
    "0 0 0",
    "1 0 0",
    "0 0",
    "1 2 3 4",
    "nan 0 0",
    "inf inf inf",
    "1e308 1e308 1e308",
    "0 0 1e-320",
    "a b c",
    "-1 0 0",
)
_TAGS = (
    "link",
    "joint",
    "mimic",
    "limit",
    "inertial",
    "visual",
    "collision",
    "origin",
    "axis",
    "mass",
    "inertia",
    "x",
)
_TAGS += (
    "dynamics",
    "geometry",
    "mesh",
    "box",
    "sphere",
    "cylinder",
    "capsule",
    "material",
    "color",
    "texture",
    "xacro:x",
)
_ATTRIBUTES = (
    "name",
    "type",
    "link",
    "joint",
    "xyz",
    "rpy",
    "value",
    "ixx",
    "ixy",
    "filename",
    "scale",
    "size",
    "radius",
)
_ATTRIBUTES += (
    "multiplier",
    "offset",
    "effort",
    "lower",
    "upper",
    "velocity",
    "damping",
    "friction",
    "rgba",
    "length",
)
_DEEP = (10, 200, 3000, 40_000)
_DOCTYPES = (
    '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">]>',
    '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE x [<!ENTITY a "a"><!ENTITY b "&a;&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;&b;&b;">]>',
    '<?xml version="1.0" encoding="utf-16"?>',
    '<?xml version="9.9" encoding="nonsense"?>',
    "<!-- -- -->",
)


def mutate_xml(text: str, random: Random) -> bytes:
    """Change one to five places of the tree; at times the text, too."""
    if random.random() < 0.85:
        root = ElementTree.fromstring(text)
        for _ in range(random.choice((1, 1, 1, 2, 3, 5))):
            random.choice(_TREE)(root, random)
        text = ElementTree.tostring(root, encoding="unicode")
    if random.random() < 0.08:
        text = random.choice(_TEXT)(text, random)
    if random.random() < 0.1:
        text = mutate_lines(text, random)
    data = text.encode("utf-8", errors="surrogatepass")
    return mutate_bytes(data, random) if random.random() < 0.2 else data


def _any(root: _Element, random: Random) -> _Element:
    return random.choice(list(root.iter()))


def _below(root: _Element, random: Random) -> tuple[_Element, _Element] | None:
    """A parent and a child of it."""
    pairs = [(parent, child) for parent in root.iter() for child in parent]
    return random.choice(pairs) if pairs else None


def _value(random: Random) -> str:
    return random.choice(random.choice((EXTREMES, EXTREMES, _WORDS, _VECTORS)))


def _set(root: _Element, random: Random) -> None:
    holders = [element for element in root.iter() if element.attrib]
    if holders:
        element = random.choice(holders)
        element.set(random.choice(list(element.attrib)), _value(random))


def _number_in_list(root: _Element, random: Random) -> None:
    """One number of "0 0 1" another one, or one more, or one less."""
    holders = [(e, k) for e in root.iter() for k, v in e.attrib.items() if len(v.split()) > 1]
    if not holders:
        return
    element, key = random.choice(holders)
    words = element.attrib[key].split()
    place = random.randrange(len(words))
    words[place : place + random.choice((0, 1, 1, 1))] = random.choice(
        ([random.choice(EXTREMES)], [], ["0", "0"])
    )
    element.set(key, " ".join(words))


def _scale(root: _Element, random: Random) -> None:
    """A number by a factor: what is still a model."""
    holders = [(e, k) for e in root.iter() for k, v in e.attrib.items() if _is_number(v)]
    if holders:
        element, key = random.choice(holders)
        factor = random.choice((-1, 0, 0.5, 2, 1e3, 1e-3, 1e6, 1e-6, 1e12, 1e-12, 1e30))
        element.set(key, repr(float(element.attrib[key]) * factor))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _drop_attribute(root: _Element, random: Random) -> None:
    element = _any(root, random)
    if element.attrib:
        del element.attrib[random.choice(list(element.attrib))]


def _add_attribute(root: _Element, random: Random) -> None:
    _any(root, random).set(random.choice(_ATTRIBUTES), _value(random))


def _drop_element(root: _Element, random: Random) -> None:
    if pair := _below(root, random):
        pair[0].remove(pair[1])


def _repeat_element(root: _Element, random: Random) -> None:
    if pair := _below(root, random):
        for _ in range(random.choice((1, 1, 1, 1, 2, 40, 1000))):
            pair[0].append(copy.deepcopy(pair[1]))


def _move_element(root: _Element, random: Random) -> None:
    if pair := _below(root, random):
        _any(root, random).append(copy.deepcopy(pair[1]))
        if random.random() < 0.5:
            pair[0].remove(pair[1])


def _rename_element(root: _Element, random: Random) -> None:
    _any(root, random).tag = random.choice(_TAGS)


def _new_element(root: _Element, random: Random) -> None:
    attributes = {random.choice(_ATTRIBUTES): _value(random) for _ in range(random.randrange(4))}
    ElementTree.SubElement(_any(root, random), random.choice(_TAGS), attributes)


def _same_value(root: _Element, random: Random) -> None:
    """Put one attribute's value in another's place: cycles, joints to themselves, names that occur twice."""
    key = random.choice(("link", "link", "name", "joint", "type", "filename", "id", "url", "source"))
    holders = [element for element in root.iter() if key in element.attrib]
    if len(holders) > 1:
        one, other = random.sample(holders, 2)
        values = one.attrib[key], other.attrib[key]
        other.set(key, values[0])
        if random.random() < 0.5:
            one.set(key, values[1])


def _text(root: _Element, random: Random) -> None:
    holders = [element for element in root.iter() if element.text and element.text.strip()] or [root]
    element = random.choice(holders)
    words = (element.text or "").split()
    if words:
        words[random.randrange(len(words))] = _value(random)
    element.text = random.choice((" ".join(words), " ".join(words[:-1]), _value(random)))


_TREE = (_set, _set, _set, _number_in_list, _number_in_list, _scale, _scale, _drop_attribute, _add_attribute)
_TREE += (
    _drop_element,
    _repeat_element,
    _move_element,
    _rename_element,
    _new_element,
    _same_value,
    _same_value,
    _text,
)


def _prologue(text: str, random: Random) -> str:
    return random.choice(_DOCTYPES) + text.replace(">", "> &c; &a;", random.choice((0, 1)))


def _nest(text: str, random: Random) -> str:
    depth = random.choice(_DEEP)
    return text.replace(">", ">" + "<link>" * depth + "</link>" * depth, 1)


def _odd(text: str, random: Random) -> str:
    return random.choice(
        ("\ufeff" + text, text + text, text + "x", "<![CDATA[" + text, text.replace('"', "'", 1), "")
    )


_TEXT = (_prologue, _nest, _odd)
