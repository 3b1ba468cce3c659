"""The public face: laziness, caching, frames by name, errors."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import InvalidValue, UnknownFrame, UnknownJoint
from mbocp.symbolic import model_functions


@pytest.fixture
def model() -> pin.Model:
    return pin.buildSampleModelManipulator()


def test_equal_models_share_their_functions(model):
    functions = model_functions(model)
    assert model_functions(pin.Model(model)) is functions
    assert functions.rnea is functions.rnea
    changed = pin.Model(model)
    changed.gravity = pin.Motion.Zero()
    assert model_functions(changed) is not functions


def test_functions_inline_into_sx_and_are_called_from_mx(model):
    functions = model_functions(model)
    q = ca.SX.sym("q", model.nq)
    assert functions.crba(q).shape == (model.nv, model.nv)
    Q = ca.MX.sym("q", model.nq)
    call = ca.Function("call", [Q], [functions.gravity(Q)])
    assert call(pin.neutral(model)).shape == (model.nv, 1)
    assert functions.rnea.is_a("SXFunction")
    assert functions.rnea.name_in() == ["q", "v", "a"]


def test_frames_go_by_name_and_by_index(model):
    functions = model_functions(model)
    name = functions.frames[-1]
    by_name = functions.frame_placement(name)
    assert by_name is functions.frame_placement(len(functions.frames) - 1)
    assert functions.frame_jacobian(name, "world") is not functions.frame_jacobian(name, "local")
    assert by_name.size1_out(0) == 3


def test_unknown_frame_suggests_a_name(model):
    functions = model_functions(model)
    near = functions.frames[-1] + "x"
    with pytest.raises(UnknownFrame, match=f"did you mean '{functions.frames[-1]}'") as caught:
        functions.frame_placement(near)
    assert caught.value.name == near
    with pytest.raises(UnknownFrame, match="#-1"):
        functions.frame_velocity(-1)
    with pytest.raises(UnknownFrame, match=f"#{len(functions.frames)}"):
        functions.frame_jacobian(len(functions.frames))


def test_unknown_reference_is_refused(model):
    with pytest.raises(InvalidValue, match="'body', expected 'world' or 'local' or"):
        model_functions(model).frame_jacobian(1, "body")


def test_constraints_without_meaning_are_refused(model):
    functions = model_functions(model)
    other = pin.buildSampleModelHumanoid()
    foreign = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, other, other.njoints - 1)
    with pytest.raises(UnknownJoint, match=f"#{other.njoints - 1}"):
        functions.constraint_jacobian([foreign])
    world = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, 1)
    world.reference_frame = pin.ReferenceFrame.WORLD
    with pytest.raises(InvalidValue, match="LOCAL_WORLD_ALIGNED"):
        functions.constraint_jacobian([world])


def test_no_constraints_have_an_empty_jacobian(model):
    J = model_functions(model).constraint_jacobian([])(np.zeros(model.nq))
    assert J.shape == (0, model.nv)
