"""BLASFEO with kernels for the processor at hand: the same products, through its own interface."""

from __future__ import annotations

import ctypes
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbocp.solvers.nlp.blasfeo import accelerate_blasfeo
from mbocp.transcription.compilation import has_avx2

LIBRARY = Path(ca.__file__).parent / "libblasfeo.so.0"
KERNELS = ("kernel_dgemm_nt_4x4_lib4", "kernel_dgemv_n_4_lib4", "kernel_dgemv_t_4_lib4")
ROOM = 256  # bytes for a matrix's or vector's record

pytestmark = pytest.mark.skipif(not has_avx2() or not LIBRARY.is_file(), reason="no AVX2 or no BLASFEO")


def pointer(array):
    return array.ctypes.data_as(ctypes.c_void_p)


class Blasfeo:
    """Matrices and vectors in BLASFEO's own format."""

    def __init__(self):
        self.library = ctypes.CDLL(str(LIBRARY))

    def matrix(self, values):
        record, values = ctypes.create_string_buffer(ROOM), np.asfortranarray(values)
        self.library.blasfeo_allocate_dmat(*values.shape, record)
        self.library.blasfeo_pack_dmat(*values.shape, pointer(values), values.shape[0], record, 0, 0)
        return record

    def vector(self, values):
        record = ctypes.create_string_buffer(ROOM)
        self.library.blasfeo_allocate_dvec(len(values), record)
        self.library.blasfeo_pack_dvec(len(values), pointer(values), 1, record, 0)
        return record

    def numbers(self, record, size):
        found = np.empty(size)
        self.library.blasfeo_unpack_dvec(size, record, 0, pointer(found), 1)
        return found


def test_kernels_are_replaced_once_they_agree():
    assert accelerate_blasfeo() == KERNELS


@pytest.mark.parametrize("sizes", [(1, 1, 1), (4, 4, 4), (5, 3, 7), (16, 13, 13), (9, 18, 2), (3, 2, 0)])
def test_products_of_matrices(sizes):
    accelerate_blasfeo()
    m, n, k = sizes
    rng, blasfeo = np.random.default_rng(1), Blasfeo()
    a, b, c = rng.normal(size=(m, k)), rng.normal(size=(n, k)), rng.normal(size=(m, n))
    into = blasfeo.matrix(c)
    blasfeo.library.blasfeo_dgemm_nt(
        m, n, k, ctypes.c_double(-1.5), blasfeo.matrix(a), 0, 0, blasfeo.matrix(b), 0, 0,
        ctypes.c_double(0.5), into, 0, 0, into, 0, 0,
    )  # fmt: skip
    found = np.empty((m, n), order="F")
    blasfeo.library.blasfeo_unpack_dmat(m, n, into, 0, 0, pointer(found), m)
    assert found == pytest.approx(-1.5 * a @ b.T + 0.5 * c, abs=1e-13)


@pytest.mark.parametrize("name", ["blasfeo_dgemv_n", "blasfeo_dgemv_t"])
@pytest.mark.parametrize("skipped", [0, 1, 3])  # rows above the block: it begins within a panel
@pytest.mark.parametrize("beta", [0.0, 1.0])
def test_products_with_vectors(name, skipped, beta):
    accelerate_blasfeo()
    rng, blasfeo = np.random.default_rng(2), Blasfeo()
    m, n = 11, 6
    whole = rng.normal(size=(skipped + m, n))
    block = whole[skipped:] if name.endswith("n") else whole[skipped:].T
    x, y = rng.normal(size=block.shape[1]), rng.normal(size=block.shape[0])
    into = blasfeo.vector(y)
    getattr(blasfeo.library, name)(
        m, n, ctypes.c_double(2.0), blasfeo.matrix(whole), skipped, 0, blasfeo.vector(x), 0,
        ctypes.c_double(beta), into, 0, into, 0,
    )  # fmt: skip
    assert blasfeo.numbers(into, len(y)) == pytest.approx(2.0 * block @ x + beta * y, abs=1e-13)
