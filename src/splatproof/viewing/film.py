"""Films as mp4 (H.264) or webm (VP9), written whole or not at all; the package av does it, where installed."""

import importlib
import importlib.util
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from splatproof.base.errors import MissingError, UsageError
from splatproof.base.files import remove_stale, whole_file

CODECS = {
    ".mp4": ("mp4", "libx264", {"crf": "18", "preset": "medium", "movflags": "+faststart"}),
    ".webm": ("webm", "libvpx-vp9", {"crf": "24", "b": "0", "row-mt": "1", "cpu-used": "4"}),
}
"""Container, codec and its options by the file's ending: constant quality, plays in any browser."""


def check_film(out: Path, width: int, height: int) -> None:
    """Refuse, before anything is drawn, a film that cannot be written.

    Args:
        out: The file.
        width: Pixels.
        height: Pixels.
    Raises: UsageError for another ending or an odd size; MissingError without the package av.
    """
    if out.suffix not in CODECS:
        raise UsageError(f"{out}: ends in {out.suffix!r}, expected {' or '.join(CODECS)}")
    if width % 2 or height % 2 or min(width, height) < 2:
        raise UsageError(f"{out}: {width} x {height} pixels, expected even numbers, 2 or more")
    if importlib.util.find_spec("av") is None:
        raise MissingError(
            f"{out}: no package av, which writes films; pip install 'splatproof[video]'"
        )


class Film:
    """A film that is being written."""

    def __init__(self, container: Any, stream: Any) -> None:
        """Take what `writing` opened.

        Args:
            container: Open file of the package av.
            stream: Its stream of pictures.
        """
        self._container, self._stream = container, stream

    def add(self, picture: UInt8[np.ndarray, "h w 3"]) -> None:
        """One more frame.

        Args:
            picture: sRGB, as large as the film.
        """
        av = importlib.import_module("av")
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        # players take BT.709 for granted where nothing is said; so is what is written
        planes = frame.reformat(
            format="yuv420p",
            src_colorspace="ITU709",
            dst_colorspace="ITU709",
            dst_color_range="MPEG",
        )
        for packet in self._stream.encode(planes):
            self._container.mux(packet)


@contextmanager
def writing(out: Path, *, width: int, height: int, fps: float) -> Iterator[Film]:
    """A film whose frames are added inside the block; the file is there when the block ends well.

    Args:
        out: File that ends in .mp4 or .webm; one that is there is replaced.
        width: Pixels, even.
        height: Pixels, even.
        fps: Frames a second.
    Raises: see `check_film`.
    """
    check_film(out, width, height)
    av = importlib.import_module("av")
    kind, codec, options = CODECS[out.suffix]
    remove_stale(out)
    with whole_file(out) as path, av.open(str(path), "w", format=kind) as container:
        stream = container.add_stream(codec, rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = options
        stream.codec_context.color_range = 1  # studio range
        stream.codec_context.colorspace = 1  # BT.709
        stream.codec_context.color_primaries = 1
        stream.codec_context.color_trc = 1
        yield Film(container, stream)
        for packet in stream.encode(None):
            container.mux(packet)
