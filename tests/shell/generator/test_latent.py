"""A latent between those of two seeds: a great circle, in the first seed's phases."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mesoshell as ms
from mesoshell.cli.commands import texture as texture_command
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from mesoshell.shell.generator import texture_synthesis
from mesoshell.shell.generator.model import generator_model, grown, slerp
from mesoshell.shell.generator.texture_synthesis import TextureRequest, grow
from tests.helpers import growing

MESH = Path(__file__).parents[2] / "data" / "suzanne.obj"
BETA = np.array([0.25], np.float32)


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return growing.bundle()


def slerp64(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    """By Gram-Schmidt, in float64."""
    u, v = a / np.linalg.norm(a), b / np.linalg.norm(b)
    across = v - (v @ u) * u
    angle = np.arctan2(np.linalg.norm(across), v @ u)
    return np.cos(t * angle) * u + np.sin(t * angle) * across / np.linalg.norm(across)


@given(st.integers(0, 2**32 - 1), st.sampled_from([16, 512]), st.floats(0, 1))
def test_it_goes_along_a_great_circle(seed: int, size: int, t: float):
    a, b = np.random.default_rng(seed).normal(size=(2, size))
    found = slerp(jnp.asarray(a[None], jnp.float32), jnp.asarray(b[None], jnp.float32), t)
    np.testing.assert_allclose(np.asarray(found[0]), slerp64(a, b, t), rtol=0, atol=1e-5)


@pytest.mark.parametrize("b", [1.0, 1.0 + 1e-6, 3.0, -1.0], ids=str)
@pytest.mark.parametrize("t", [0.0, 1e-30, 0.5, 1.0], ids=str)
def test_on_one_line_it_is_straight(b: float, t: float):
    """The same latent, one of another norm, the opposite one: the angle's sine is 0."""
    a = np.array([[0.6, 0.8]], np.float32)
    found = np.asarray(slerp(jnp.asarray(a), jnp.asarray(np.float32(b) * a), t))
    np.testing.assert_allclose(found, ((1 - t) + t * np.sign(b)) * a, rtol=1e-5, atol=1e-5)


def test_it_goes_from_a_seed_to_the_other_s_latent_and_keeps_phases(bundle: Bundle):
    maker = generator_model(bundle, "it")
    one, other = (grown(maker, seed, BETA) for seed in (7, 9))
    along = [grown(maker, 7, BETA, (9, t)) for t in (0.0, 0.5, 1.0)]
    np.testing.assert_allclose(along[0].w, one.w, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(along[2].w, other.w, rtol=1e-5, atol=1e-6)
    assert all(np.abs(np.asarray(along[1].w - x.w)).max() > 0.01 for x in (one, other))
    for found in along:
        jax.tree.map(np.testing.assert_array_equal, found.phases, one.phases)


def test_textures_between_are_textures_of_their_own(bundle: Bundle, monkeypatch: pytest.MonkeyPatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    growing.without_grids(monkeypatch)
    uv = np.array([[[0.1, 0.1], [0.9, 0.1], [0.5, 0.9]]], np.float32)
    made = [grow(bundle, "it", uv, TextureRequest(7, latent=latent))[0] for latent in (None, (9, 0.0), (9, 0.5))]
    plain, begun, between = (x.arrays["features/0"].astype(np.float32) for x in made)
    np.testing.assert_allclose(begun, plain, rtol=0, atol=0.01 * plain.std())
    assert np.abs(between - plain).max() > 0.05 * plain.std()
    assert made[2].provenance["latent"] == [9, 0.5] and "latent" not in made[0].provenance


def test_scenes_and_commands_take_it(bundle: Bundle, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """And what is kept for the next render is kept apart."""
    keys: set[str] = set()
    monkeypatch.setattr(texture_synthesis, "kept", lambda key, size, make: (keys.add(key), make(None))[1])
    growing.without_grids(monkeypatch)
    write_bundle(tmp_path / "it.npz", bundle)
    material, found = ms.load_material(tmp_path / "it.npz"), {}
    for latent in (None, (9, 0.0), (9, 0.5)):
        still = settle(ms.Scene(MESH, material, scale=2.0, seed=7, latent=latent))
        assert still.latent is None
        found[latent] = still.material.shell.arrays["features/0"].astype(np.float32)
    np.testing.assert_array_equal(found[None], found[9, 0.0])
    assert np.abs(found[None] - found[9, 0.5]).max() > 0.05 * found[None].std()
    assert len(keys) == 2

    asked = []

    def made(bundle: Bundle, name: str, size: tuple[int, int], wanted: TextureRequest, *_: object) -> None:
        asked.append(wanted.latent)
        raise InputError(name, "is made no further")

    monkeypatch.setattr(texture_command, "bake_bundle", made)
    given = ["texture", str(tmp_path / "it.npz"), "--out", str(tmp_path / "a.npz")]
    for more in ([], ["--latent", "9", "0.5"], ["--latent", "9", "1.5"]):
        with pytest.raises(SystemExit):
            main([*given, *more])
    assert asked == [None, (9, 0.5)]


@pytest.mark.parametrize(
    ("latent", "said"),
    [
        ((2**32, 0.5), "4294967296 must be from"),
        ((1, 1.5), "from 0 to 1, not 1.5"),
        ((1, float("nan")), "not nan"),
    ],
)
def test_what_it_cannot_go_toward_is_refused(bundle: Bundle, latent, said: str):
    with pytest.raises(InputError, match=f"^latent: .*{said}"):
        ms.explain(ms.Scene(MESH, Material("it", bundle), latent=latent))


@pytest.mark.parametrize("name", ["lawn", "grass", "turf"])
def test_what_has_no_latent_says_so(name: str, capsys: pytest.CaptureFixture[str]):
    for options in ((str(MESH), "--material", name), (str(MESH), "--object", f"{MESH}={name}")):
        latent = ["--latent", "3", "0.5"] if "--material" in options else ["--param", f"{name}:latent=3,0.5"]
        with pytest.raises(SystemExit) as caught:
            main(["render", *options, *latent])
        fault = capsys.readouterr().err
        assert caught.value.code == 2 and fault.count("\n") == 1
        assert f"latent: {name} has no latent z\n" in fault
