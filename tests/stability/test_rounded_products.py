"""What a GPU or a TPU would round: nothing but the layers of networks, in no program of the package.

A GPU may keep 10 bits of an operand of a matrix product (TF32), a TPU 7 (bfloat16), unless its precision is set. Oracles: the
programs themselves, and the walk with operands rounded on a CPU (benchmarks/products) against mpmath.
"""

import ast
from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.products import products, unset
from mesoshell.numerics import product
from tests.helpers.stability.programs import ELSEWHERE, SOURCES, Programs, compiled, programs

#: One process traces what its tests share.
pytestmark = pytest.mark.xdist_group("rounded_products")

#: Files that import JAX whose `@` is NumPy's, and the one product that may be rounded.
ALLOWED = {
    "signal/fourier.py",
    "shell/material/precision.py",
    "neutex/mesh.py",
    "nets/mlp.py",
    "train/textures/exemplars.py",
}
#: What a random start is made with: rounded, it is another start.
START = {"train/textures/natural_start.py": {"jnp.linalg.eigh", "jnp.linalg.qr"}}
#: The same in a compiled program: solvers, which take no precision.
SOLVED = {"train.textures.natural_start._natural": {"eigh", "geqrf", "householder_product", "qr"}}
#: Functions of jax.numpy and jax.lax that are made of products.
PRODUCTS = {"dot", "vdot", "matmul", "einsum", "tensordot", "inner", "dot_general", "conv_general_dilated", "conv"}
SOLVERS = {"inv", "solve", "det", "pinv", "lstsq", "eigh", "svd", "qr", "cholesky", "matrix_power", "multi_dot"}


@pytest.fixture(scope="module")
def every(tiny_bundle) -> Programs:
    return programs(tiny_bundle)


def test_every_compiled_function_is_among_the_programs(every):
    """A new one is put into `programs.py`."""
    assert compiled() - set(every) == ELSEWHERE


@pytest.mark.slow  # it traces them all
def test_no_product_outside_of_networks_may_be_rounded(every):
    found = {}
    for name, makers in every.items():
        equations = [e for trace in makers for e in unset(trace().jaxpr)]
        found[name] = [str(e) for e in equations if e.primitive.name not in SOLVED.get(name, ())]
    assert {name: equations for name, equations in found.items() if equations} == {}


def test_a_network_s_products_are_seen(every, tiny_bundle):
    """The test above does not hold because nothing is found."""
    layers = sum(name.startswith("decoder/trunk") and name.endswith("kernel") for name in tiny_bundle.arrays)
    for trace in every["shell.render.kernels.density"]:
        assert [network for _, network in products(trace().jaxpr)] == [True] * (layers + 1)


def _said(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            yield "@"
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            of, name = ast.unparse(node.func.value), node.func.attr
            given = {k.arg for k in node.keywords}
            if of in ("jnp", "jax.numpy", "jax.lax", "lax") and name in PRODUCTS and "precision" not in given:
                yield f"{of}.{name}"
            if of in ("jnp.linalg", "jax.scipy.linalg") and name in SOLVERS:
                yield f"{of}.{name}"


def test_products_in_the_sources_say_their_precision():
    """Those of functions that are not compiled, too."""
    found = {}
    for path in SOURCES.rglob("*.py"):
        text = path.read_text()
        if "import jax" in text or "from jax " in text:
            found[path.relative_to(SOURCES).as_posix()] = set(_said(ast.parse(text)))
    assert {name: said for name, said in found.items() if said} == {name: {"@"} for name in ALLOWED} | START


@pytest.mark.parametrize(("a", "b"), [((3,), (3,)), ((3, 3), (3,)), ((3,), (3, 2)), ((2, 3), (3, 4)), ((0, 3), (3,))])
def test_a_sum_of_products_is_the_product(a: tuple[int, ...], b: tuple[int, ...]):
    random = np.random.default_rng(0)
    x, y = (random.normal(size=shape).astype(np.float32) for shape in (a, b))
    exact, most = x.astype(np.float64) @ y, np.abs(x).astype(np.float64) @ np.abs(y)
    found = product(jnp.asarray(x), jnp.asarray(y))
    assert found.shape == exact.shape
    assert (np.abs(np.asarray(found) - exact) <= 2 * np.finfo(np.float32).eps * most).all()
