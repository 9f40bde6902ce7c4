"""Every attribute of the broker's stored state has a docstring below it."""

from __future__ import annotations

import ast
import inspect
import itertools
import textwrap

import pytest

from broker.decisions.state import Command, DeferredAnalysis, HaltSentence, PendingJob, Rollout, State, SubsystemState
from rtc.programs.action_stack import ActionStack


@pytest.mark.parametrize(
    "kind", [State, Command, PendingJob, ActionStack, DeferredAnalysis, HaltSentence, SubsystemState, Rollout]
)
def test_every_attribute_has_a_docstring(kind):
    (body,) = (node.body for node in ast.parse(textwrap.dedent(inspect.getsource(kind))).body)
    documented = {
        field.target.id
        for field, below in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
    }
    assert set(kind.__struct_fields__) - documented == set()
