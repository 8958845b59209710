"""Distances between two images: PSNR and SSIM (NumPy and scikit-image only).

symbol  meaning                                                       shape, unit
a, b    finite images of one shape                                    (H, W, C) or (H, W), any one scale
L       peak: the largest value the scale has (1 for x/(1+x) and sRGB)
MSE     mean of (a − b)² over pixels and channels                     L²
PSNR    10 log10(L² / MSE)                                            dB; +∞ for equal images
SSIM    Wang et al. 2004, equation 13: K1 = 0.01, K2 = 0.03, Gaussian window of σ = 1.5 pixels cut to 11 × 11 taps

SSIM is taken on each channel and the mean is over channels and over the pixels whose whole window lies in the image, as
the authors' own program does. Moments are biased (the window's weights sum to 1). Everything is computed in float64.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from skimage.metrics import structural_similarity

_WINDOW = 11


def psnr(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."], peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB; +∞ if the images are equal. Raises ValueError if their shapes differ."""
    _same_shape(a, b)
    error = float(np.mean(np.square(a.astype(np.float64) - b.astype(np.float64))))
    return 10 * math.log10(peak**2 / error) if error else math.inf


def psnr_masked(
    a: Float[np.ndarray, "H W C"], b: Float[np.ndarray, "H W C"], mask: Bool[np.ndarray, "H W"], peak: float = 1.0
) -> float:
    """PSNR in dB over the pixels of `mask` (the foreground) alone. Raises ValueError if the mask is empty."""
    if not mask.any():
        raise ValueError("PSNR over an empty mask")
    return psnr(a[mask], b[mask], peak)


def psnr_blocks(a: Float[np.ndarray, "H W C"], b: Float[np.ndarray, "H W C"], k: int, peak: float = 1.0) -> float:
    """PSNR in dB of the means over k × k blocks: sampling noise averages out, bias stays.

    Raises ValueError if H or W is not a multiple of k.
    """
    return psnr(_block_means(a, k), _block_means(b, k), peak)


def ssim(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."], peak: float = 1.0) -> float:
    """Structural similarity, 1 for equal images; (H, W) or (H, W, C), mean of the channels.

    Raises ValueError if the shapes differ or a side is below the window's 11 pixels.
    """
    _same_shape(a, b)
    if min(a.shape[:2]) < _WINDOW:
        raise ValueError(f"SSIM needs {_WINDOW} pixels a side, not {a.shape[0]} × {a.shape[1]}")
    x, y = a.astype(np.float64), b.astype(np.float64)
    how: dict[str, Any] = {"gaussian_weights": True, "use_sample_covariance": False}
    similarity: Any = structural_similarity(x, y, data_range=peak, channel_axis=-1 if a.ndim == 3 else None, **how)
    return float(similarity)


def _same_shape(a: np.ndarray, b: np.ndarray) -> None:
    if a.shape != b.shape:
        raise ValueError(f"images of different shapes: {a.shape} and {b.shape}")


def _block_means(image: np.ndarray, k: int) -> np.ndarray:
    height, width, channels = image.shape
    if height % k or width % k:
        raise ValueError(f"{height} × {width} pixels are not whole blocks of {k} × {k}")
    return image.astype(np.float64).reshape(height // k, k, width // k, k, channels).mean(axis=(1, 3))
