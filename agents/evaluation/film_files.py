"""Pictures as the files of a film: GIF, MP4, or the last of them as PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import imageio.v3 as iio
import numpy as np
from PIL import Image

from agents.records.atomic import write_atomically

FORMATS: Final = (".gif", ".mp4", ".png")
COLOURS: Final = 255
"""Of a GIF, the same in all its pictures: looking for them in each would cost more than drawing it."""


def check_format(output: Path) -> None:
    """Raise ValueError unless a film can be written under this name."""
    if output.suffix not in FORMATS:
        raise ValueError(f"output = {str(output)!r} must end in one of {', '.join(FORMATS)}")


def write_film(output: Path, frames: Sequence[Any], frames_per_second: int) -> None:
    """Write RGB pictures (h, w, 3) as a film, or the last of them, as a whole."""
    write_atomically(output, _film(frames, output.suffix, frames_per_second))


def _film(frames: Sequence[Any], suffix: str, frames_per_second: int) -> bytes:
    if suffix == ".png":
        return iio.imwrite("<bytes>", frames[-1], extension=suffix)
    if suffix == ".gif":
        return _gif(frames, frames_per_second)
    return iio.imwrite(
        "<bytes>", list(frames), extension=suffix, fps=frames_per_second, codec="libx264", macro_block_size=8
    )


def _gif(frames: Sequence[Any], frames_per_second: int) -> bytes:
    """With the colours of the first, the middle and the last picture."""
    some = np.concatenate([frames[0], frames[len(frames) // 2], frames[-1]])
    plain = Image.Dither.NONE  # dots would flicker
    palette = Image.fromarray(some).quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=plain)
    first, *others = (Image.fromarray(frame).quantize(palette=palette, dither=plain) for frame in frames)
    buffer = io.BytesIO()
    first.save(
        buffer, "GIF", save_all=True, append_images=others, duration=1000 // frames_per_second, loop=0, optimize=False
    )
    return buffer.getvalue()
