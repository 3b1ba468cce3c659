"""Mutated inputs thrown at mbocp: `python -m tests.attack --count 2000`; `make attack` is the recorded run.

An input is made of its kind and a seed number, and of nothing else. What it may end in is a result or an
`MbocpError`, within limits of time, memory and length of the message; all else is a finding.

    corpus.py       files that are mutated: of robots/, examples/ and example-robot-data
    raw.py          mutations of bytes and of lines
    trees.py        mutations of TOML, and of what YAML holds
    yamls.py        mutations of YAML
    elements.py     mutations of XML: URDF and Collada
    meshes.py       mutations of OBJ, MTL and STL
    containers.py   mutations of HDF5, by bit and by structure
    cases.py        kind and seed -> files
    targets.py      what is done with them
    runner.py       processes that do it, under limits
    report.py       the table
    guided.py       runs coverage.py, and counts
    coverage.py     the same inputs, guided by the coverage of mbocp's lines (atheris; optional)
"""
