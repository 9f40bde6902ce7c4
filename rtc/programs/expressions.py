"""Arithmetic expressions of programs, such as `0.5*(GP1 + GP2)` or `0.5*(pre_grasp_m - grasp_width_m) + overrun_m`.

Allowed are numbers, poses, + - * /, brackets, min, max and abs only, so that a program stays data. A name may have one
point: `object.bar_width_m`. Poses can only be averaged: a sum of poses whose weights add up to one is their weighted
mean (position: mean, attitude: quaternion mean).
Attitudes more than 5 degrees apart are refused (A15). Knows neither the world nor scripts.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from rtc.protocol.spelling import did_you_mean, nearest
from rtc.spatial import geometry

MAX_APART_RAD = math.radians(5.0)  # maximum angle between averaged attitudes (A15)
MAX_CHARACTERS = 200  # maximum length in characters


class ExpressionError(ValueError):
    """The text is not an expression, contains an unknown name, or has no value."""


@dataclass(frozen=True)
class Poses:
    """An intermediate sum of weighted poses: (weight, pose of seven floats) each."""

    parts: tuple[tuple[float, tuple[float, ...]], ...]


Value = float | Poses
Given = Mapping[str, float | list[float]]  # numbers, and poses of seven floats

FUNCTIONS: dict[str, Callable[..., float]] = {"min": min, "max": max, "abs": abs}


def evaluate(text: str | float, given: Given) -> float | list[float]:
    """The value of an expression: a number, or a pose of seven floats. Raises ExpressionError with the reason."""
    if isinstance(text, int | float):
        return float(text)
    value = _value(parse(text), given)
    return value if isinstance(value, float) else _mean(value)


def number(text: str | float, given: Given) -> float:
    """As `evaluate`, but only a number is accepted. Raises ExpressionError for a pose."""
    value = evaluate(text, given)
    if not isinstance(value, float):
        raise ExpressionError(f"{text} is a pose; a number is required")
    return value


def names(text: str | float) -> set[str]:
    """The names in an expression. Raises ExpressionError."""
    if isinstance(text, int | float):
        return set()
    return _names(parse(text)) - FUNCTIONS.keys()


def _names(node: ast.AST) -> set[str]:
    if isinstance(node, ast.Name | ast.Attribute):
        return {ast.unparse(node)}
    return {name for inner in ast.iter_child_nodes(node) for name in _names(inner)}


@lru_cache(maxsize=1024)
def parse(text: str) -> ast.expr:
    """The tree of an expression. Raises ExpressionError on anything but arithmetic."""
    if len(text) > MAX_CHARACTERS:
        raise ExpressionError(f"the expression has {len(text)} characters; the limit is {MAX_CHARACTERS}")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise ExpressionError(f"{text!r} is not an expression") from error
    for node in ast.walk(tree):
        if not isinstance(node, _ALLOWED):
            raise ExpressionError(f"{text!r}: only + - * / and brackets, {', '.join(FUNCTIONS)}")
        if isinstance(node, ast.Constant) and type(node.value) not in (int, float):
            raise ExpressionError(f"{text!r}: {node.value!r} is not a number")
        if isinstance(node, ast.Attribute) and not isinstance(node.value, ast.Name):
            raise ExpressionError(f"{text!r}: only one point in a name")
    return tree


_ALLOWED = (
    ast.BinOp, ast.UnaryOp, ast.Call, ast.Name, ast.Attribute, ast.Constant, ast.Load,
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.USub, ast.UAdd,
)  # fmt: skip


def _value(node: ast.expr, given: Given) -> Value:
    match node:
        case ast.Constant(value=bool() | str() | bytes()):
            raise ExpressionError("not a number")
        case ast.Constant(value=int() | float() as n):
            return float(n)
        case ast.Name(id=name):
            return _given(name, given)
        case ast.Attribute(value=ast.Name(id=of), attr=name):
            return _given(f"{of}.{name}", given)
        case ast.UnaryOp(op=op, operand=operand):
            return _times(-1.0 if isinstance(op, ast.USub) else 1.0, _value(operand, given))
        case ast.BinOp(left=left, op=op, right=right):
            return _OPERATORS[type(op)](_value(left, given), _value(right, given))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]) if name in FUNCTIONS and args:
            return float(FUNCTIONS[name](*(_plain(_value(arg, given)) for arg in args)))
    raise ExpressionError(f"{ast.unparse(node)} is not arithmetic")


def _given(name: str, given: Given) -> Value:
    if name not in given:
        raise ExpressionError("; ".join(filter(None, (f"{name} is not given", did_you_mean(nearest(name, given))))))
    value = given[name]
    return Poses(((1.0, tuple(value)),)) if isinstance(value, list) else float(value)


def _plain(value: Value) -> float:
    if isinstance(value, Poses):
        raise ExpressionError("poses can only be averaged")
    return value


def _times(a: Value, b: Value) -> Value:
    if isinstance(a, Poses):
        a, b = b, a
    factor = _plain(a)
    return Poses(tuple((factor * w, p) for w, p in b.parts)) if isinstance(b, Poses) else factor * b


def _plus(a: Value, b: Value) -> Value:
    if isinstance(a, Poses) and isinstance(b, Poses):
        return Poses(a.parts + b.parts)
    return _plain(a) + _plain(b)


def _over(a: Value, b: Value) -> Value:
    divisor = _plain(b)
    if divisor == 0.0:
        raise ExpressionError("division by zero")
    return _times(1.0 / divisor, a)


_OPERATORS: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: _plus,
    ast.Sub: lambda a, b: _plus(a, _times(-1.0, b)),
    ast.Mult: _times,
    ast.Div: _over,
}


def _mean(poses: Poses) -> list[float]:
    weights = [w for w, _ in poses.parts]
    if min(weights) < 0.0 or abs(sum(weights) - 1.0) > 1e-9:
        raise ExpressionError(f"weights of poses must add up to 1, these are {', '.join(f'{w:g}' for w in weights)}")
    apart = max(geometry.angle(p, q) for _, p in poses.parts for _, q in poses.parts)
    if apart > MAX_APART_RAD:
        most = math.degrees(MAX_APART_RAD)
        raise ExpressionError(
            f"attitudes {math.degrees(apart):.1f} deg apart have no mean; the limit is {most:.0f} deg"
        )
    quaternions = np.array([p[3:] for _, p in poses.parts])
    _, vectors = np.linalg.eigh((quaternions.T * np.array(weights)) @ quaternions)  # q and -q count alike
    position = np.average(np.array([p[:3] for _, p in poses.parts]), axis=0, weights=weights)
    return geometry.make_pose(position, vectors[:, -1]).tolist()
