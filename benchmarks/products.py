"""Which matrix products of a program a GPU or a TPU would round, and what the program would give if it did.

Notation
product      dot_general or convolution of float32; its operands are rounded unless its precision is HIGHEST
TF32         what a GPU's matrix units keep of an operand: 10 bits of mantissa; bfloat16, a TPU's: 7. Sums stay float32
network      the scope (`jax.named_scope`) of the layers of networks, which may be rounded (docs/results/performance.md)

On a CPU nothing is rounded: `rounded` computes there what the others would.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

#: Bits of mantissa that an operand keeps.
BITS = {"TF32": 10, "bfloat16": 7}
_PRODUCTS = ("dot_general", "conv_general_dilated")
#: Their kernels are made of products, whose precision nobody can set.
_SOLVERS = ("lu", "triangular_solve", "cholesky", "qr", "svd", "eigh", "eig", "ragged_dot_general")


def unset(jaxpr: Jaxpr) -> Iterator[Any]:
    """Equations of products outside of networks whose precision is not set, those of loops, branches and calls included."""
    return (equation for equation, network in products(jaxpr) if not network)


def products(jaxpr: Jaxpr, network: bool = False) -> Iterator[tuple[Any, bool]]:
    """All equations of products whose precision is not set, and whether they are a network's. network: whether all of it is."""
    for equation in jaxpr.eqns:
        inside = network or "network" in str(equation.source_info.name_stack)
        if _is_rounded(equation) or equation.primitive.name in _SOLVERS:
            yield equation, inside
        for body in bodies(equation):
            yield from products(body, inside)


def bodies(equation: Any) -> list[Jaxpr]:
    """Programs within an equation."""
    values = [x for v in equation.params.values() for x in (v if isinstance(v, tuple | list) else (v,))]
    return [x.jaxpr if isinstance(x, ClosedJaxpr) else x for x in values if isinstance(x, ClosedJaxpr | Jaxpr)]


def rounded(function: Callable, bits: int) -> Callable:
    """`function` of arrays with operands rounded where an accelerator would; may be compiled."""

    def found(*arguments: Any) -> Any:
        closed, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
        out = _evaluated(closed.jaxpr, closed.consts, jax.tree.leaves(arguments), bits)
        return jax.tree.unflatten(jax.tree.structure(shapes), out)

    return found


def _is_rounded(equation: Any) -> bool:
    if equation.primitive.name not in _PRODUCTS:
        return False
    precision = equation.params["precision"]
    exact = precision is not None and all(p == jax.lax.Precision.HIGHEST for p in jax.tree.leaves(precision))
    return not exact and all(v.aval.dtype == "float32" for v in equation.invars)


def _evaluated(jaxpr: Jaxpr, consts: Any, arguments: Any, bits: int) -> list:
    values = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *arguments), strict=True))
    for equation in jaxpr.eqns:
        given = [v.val if isinstance(v, Literal) else values[v] for v in equation.invars]
        values.update(zip(equation.outvars, _result(equation, given, bits), strict=True))
    return [v.val if isinstance(v, Literal) else values[v] for v in jaxpr.outvars]


def _result(equation: Any, given: list, bits: int) -> Any:
    name, of = equation.primitive.name, equation.params
    if name in ("scan", "while", "cond"):
        return {"scan": _scan, "while": _while, "cond": _cond}[name](of, given, bits)
    inner = bodies(equation)
    if len(inner) == 1 and len(inner[0].invars) == len(given):  # a call, or a function with a derivative of its own
        consts = next((v.consts for v in of.values() if isinstance(v, ClosedJaxpr)), ())
        return _evaluated(inner[0], consts, given, bits)
    if _is_rounded(equation):
        given = [jax.lax.reduce_precision(x, 8, bits) for x in given]
        of = of | {"precision": (jax.lax.Precision.HIGHEST,) * 2}
    out = equation.primitive.bind(*given, **of)
    return out if equation.primitive.multiple_results else [out]


def _scan(of: dict, given: list, bits: int) -> list:
    body, consts, carried = of["jaxpr"], of["num_consts"], of["num_carry"]

    def turn(carry: list, x: list) -> tuple[list, list]:
        out = _evaluated(body.jaxpr, body.consts, [*given[:consts], *carry, *x], bits)
        return out[:carried], out[carried:]

    begin, xs = given[consts : consts + carried], given[consts + carried :]
    carry, ys = jax.lax.scan(turn, begin, xs, of["length"], reverse=of["reverse"])
    return [*carry, *ys]


def _while(of: dict, given: list, bits: int) -> list:
    first, second = of["cond_nconsts"], of["cond_nconsts"] + of["body_nconsts"]
    test, body = of["cond_jaxpr"], of["body_jaxpr"]
    return jax.lax.while_loop(
        lambda carry: _evaluated(test.jaxpr, test.consts, [*given[:first], *carry], bits)[0],
        lambda carry: _evaluated(body.jaxpr, body.consts, [*given[first:second], *carry], bits),
        given[second:],
    )


def _cond(of: dict, given: list, bits: int) -> list:
    index, *operands = given
    branches = [lambda *x, b=b: _evaluated(b.jaxpr, b.consts, x, bits) for b in of["branches"]]
    return jax.lax.switch(index.astype("int32"), branches, *operands)
