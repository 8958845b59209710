"""Operations of a function in products and convolutions, counted in its jaxpr.

XLA's own count takes the body of a loop once; this one multiplies by the number of iterations. Of the branches of a condition
the most expensive counts.
"""

import math
from collections.abc import Callable
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr


def count_operations(function: Callable, *arguments: Any) -> float:
    """Multiplications and additions of one call. arguments: arrays or their shapes. A loop whose number of iterations
    depends on data counts once."""
    return _of(jax.make_jaxpr(function)(*arguments).jaxpr)


def _of(jaxpr: Jaxpr) -> float:
    return float(sum(_of_equation(equation) for equation in jaxpr.eqns))


def _of_equation(equation: Any) -> float:
    name, parameters = equation.primitive.name, equation.params
    if name == "dot_general":
        (contracted, _), _ = parameters["dimension_numbers"]
        left = equation.invars[0].aval.shape
        return 2.0 * math.prod(equation.outvars[0].aval.shape) * math.prod(left[i] for i in contracted)
    if name == "conv_general_dilated":
        kernel = equation.invars[1].aval.shape
        out_features = kernel[parameters["dimension_numbers"].rhs_spec[0]]
        return 2.0 * math.prod(equation.outvars[0].aval.shape) * math.prod(kernel) / out_features
    if name == "cond":
        return max(_of(branch.jaxpr) for branch in parameters["branches"])
    inner = [x for value in parameters.values() for x in (value if isinstance(value, tuple | list) else (value,))]
    bodies = [x.jaxpr if isinstance(x, ClosedJaxpr) else x for x in inner if isinstance(x, ClosedJaxpr | Jaxpr)]
    return float(parameters.get("length", 1) * sum(map(_of, bodies)))
