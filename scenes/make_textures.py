"""Writes the textures of materials/, which repeat without a seam: run it to make them again."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).parent / "materials"
SIZE = 256  # px


def noise(seed: int, grain_px: float) -> NDArray[np.float64]:
    """Gaussian noise (SIZE, SIZE) of standard deviation 1 that repeats, smooth over grains."""
    white = np.random.default_rng(seed).standard_normal((SIZE, SIZE))
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(SIZE), np.fft.rfftfreq(SIZE), indexing="ij"))
    spectrum = np.fft.rfft2(white) * np.exp(-2.0 * (np.pi * grain_px * f) ** 2)
    smooth = np.fft.irfft2(spectrum, s=white.shape)
    return (smooth - smooth.mean()) / smooth.std()


def oxide_scale() -> NDArray[np.uint8]:
    """Patches of scale, 255, on three fifths of the metal, 0; their edges are a few pixels wide."""
    field = noise(1, 12.0) + 0.5 * noise(2, 3.0)
    return np.clip(127.5 + 400.0 * (field - np.quantile(field, 0.4)), 0, 255).astype(np.uint8)


def scratches() -> NDArray[np.uint8]:
    """Scratches, up to 255, 1 to 2 px wide: nine tenths of them near the direction of u."""
    random = np.random.default_rng(3)
    image = np.zeros((SIZE, SIZE), np.uint8)
    for number in range(90):
        spread = 0.1 if number % 10 else 1.5
        angle, length = random.normal(0.0, spread), random.uniform(20, 120)
        start = random.uniform(0, SIZE, 2)
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        grey, wide = int(random.uniform(80, 255)), int(random.integers(1, 3))
        layer = np.zeros_like(image)
        for shift in np.ndindex(3, 3):  # the copies beside it make the image repeat
            a, b = ((p + SIZE * (np.array(shift) - 1)) * 16 for p in (start, end))
            cv2.line(
                layer,
                np.rint(a).astype(int).tolist(),
                np.rint(b).astype(int).tolist(),
                grey,
                wide,
                cv2.LINE_AA,
                4,
            )
        image = np.maximum(image, layer)
    return image


def edge() -> NDArray[np.uint8]:
    """Two pixels: a step across v."""
    return np.array([[0], [255]], np.uint8)


if __name__ == "__main__":
    for texture in (oxide_scale, scratches, edge):
        cv2.imwrite(str(FOLDER / f"{texture.__name__}.png"), texture())
