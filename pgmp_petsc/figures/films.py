"""Films of bodies in motion: MP4, or GIF."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
from PIL import Image

from pgmp_petsc.figures.motion import Motion
from pgmp_petsc.figures.solids import images
from pgmp_petsc.figures.style import PROGRAM
from pgmp_petsc.runtime.ending import child
from pgmp_petsc.runtime.errors import InputError, RunError
from pgmp_petsc.runtime.files import replacing

GIF, MP4 = ".gif", ".mp4"
RESOLUTION = {GIF: 80, MP4: 120}  # pixels an inch
QUALITY = "10"  # of x264, from 0, without losses, to 51
N_COLOURS = 128  # of a GIF
SLOWEST = 655.0  # s that a GIF may show a picture: two bytes of hundredths
FASTEST = 50.0  # pictures a second that a GIF may have: its times are whole hundredths


@dataclass(frozen=True)
class Pace:
    """Which instants a film shows, and how fast."""

    numbers: np.ndarray  # of the instants, in their order
    rate: float  # pictures a second

    @property
    def seconds(self) -> float:
        """How long the film takes."""
        return len(self.numbers) / self.rate

    @classmethod
    def of(cls, n: int, rate: float, seconds: float | None) -> Pace:
        """Choose from n instants: all of them, or as many as fit into the time; no picture twice.

        A film that is to take longer than all instants do at this rate shows them more slowly.
        """
        if seconds is None:
            return cls(np.arange(n), rate)
        wanted = max(1, round(seconds * rate))
        if wanted >= n:
            return cls(np.arange(n), n / seconds)
        return cls(np.unique(np.linspace(0, n - 1, wanted).round().astype(int)), rate)


def write_film(motion: Motion, path: Path, pace: Pace) -> int:
    """Write a film, whole or not at all, and return how many pictures it has; by one process.

    Raises `InputError` if there is nothing to draw or to write it with; `RunError` if the system, or what makes the
    film, fails.
    """
    ending = path.suffix.lower()
    if ending == GIF and 1.0 / pace.rate > SLOWEST:
        raise InputError(
            f"--seconds: a GIF shows one picture for {SLOWEST:g} s at most, and these would take "
            f"{1.0 / pace.rate:.4g} s each; give fewer seconds, or name the film .mp4"
        )
    pictures = images(motion, pace.numbers, RESOLUTION[ending])
    with replacing(path, "film") as partial:
        (_write_gif if ending == GIF else _write_mp4)(pictures, partial, pace.rate)
    return len(pace.numbers)


def _write_gif(pictures: Iterable[np.ndarray], path: Path, rate: float) -> None:
    first, *rest = [Image.fromarray(picture) for picture in pictures]
    palette = first.quantize(N_COLOURS)
    # one palette for all: colours mean the same in every picture
    same = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in (first, *rest)]
    duration = max(1, round(100.0 / min(rate, FASTEST))) * 10
    with open(path, "wb") as stream:
        same[0].save(
            stream, format="GIF", save_all=True, append_images=same[1:], duration=duration, loop=0,
            comment=PROGRAM.encode(),
        )  # fmt: skip


def _write_mp4(pictures: Iterator[np.ndarray], path: Path, rate: float) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError(
            f"MP4 is written by imageio-ffmpeg, which cannot be imported ({error}); pip install imageio-ffmpeg, or "
            "name the film .gif"
        ) from error
    first = next(pictures)
    height, width = (length - length % 2 for length in first.shape[:2])
    command = [
        imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error",
        "-f", "rawvideo", "-s", f"{width}x{height}", "-pix_fmt", "rgb24", "-r", str(Fraction(rate).limit_denominator()),
        "-i", "-", "-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", "-crf", QUALITY,
        "-metadata", f"comment={PROGRAM}", "-f", "mp4", "-movflags", "+faststart", path,
    ]  # fmt: skip
    with TemporaryFile() as said:
        with child(command, stdin=subprocess.PIPE, stderr=said) as ffmpeg:
            with suppress(BrokenPipeError):  # it has ended, and its status says so
                for picture in (first, *pictures):
                    ffmpeg.stdin.write(np.ascontiguousarray(picture[:height, :width]))
                ffmpeg.stdin.close()
            ffmpeg.wait()
        if ffmpeg.returncode != 0:
            said.seek(0)
            lines = said.read().decode(errors="replace").split("\n")
            raise RunError(f"the film could not be written: {lines[0] or f'ffmpeg ended with {ffmpeg.returncode}'}")
