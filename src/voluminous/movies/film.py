"""Films: every frame a picture in a file; then all of them one file, if that is asked for."""

from __future__ import annotations

import functools
import os
import re
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras import Camera
from ..colormaps import get_colormap
from ..digest import content_key
from ..errors import InputError
from ..executors import Sent, as_executor, run_tasks
from ..files import (
    as_path,
    check_parent,
    make_directory,
    remove_unfinished,
    replacing,
    seen_from,
    stamp,
)
from ..image import Image
from ..io import open as open_volume
from ..media import Coefficients, Medium
from ..progress import Progress, with_progress
from ..rendering.options import check_options
from ..units import is_count, shown
from ..volume import Volume
from .encode import ENCODERS, check_fps, encode
from .frame import Frame, display, draw, provenance, volume_of

PICTURES = (".png", ".exr", ".fits", ".tif", ".tiff", ".npz")
# Frames that are drawn first, coarsely, to find the exposure of all; and that messages name.
_SAMPLES = 16
# Display options that fix the brightness.
_FIXED = ("exposure", "vmin", "vmax", "norm")
# Arrays of more bytes are not sent along with each frame.
_MOST_SENT = 8 << 20


@with_progress
def movie(
    volume: Any,
    medium: Any,
    cameras: Camera | Sequence[Camera],
    path: str | Path,
    *,
    fps: float = 30.0,
    picture: dict[str, Any] | None = None,
    project: dict[str, Any] | None = None,
    finish: Callable[[Image], Image] | None = None,
    codec: str = "libx264",
    keep_frames: bool = False,
    executor: Any = None,
    share: tuple[int, int] | None = None,
    progress: Progress = None,
    **options: Any,
) -> list[Path]:
    """Render a film.

    Frames are written one by one, each whole. A film that was interrupted goes on where it was: the
    same call makes only what is missing, damaged, or was made with other arguments.

    Parameters
    ----------
    volume : Volume, path, function that returns a Volume, or sequence of them
        A sequence is a series in time, opened one by one; it is spread evenly over the frames.
        ``functools.partial(vm.open, path, unit="pc")`` opens a file with options: it is identified
        by its arguments, and by name, size and time of its files. Any other function is also
        called to see what it returns before frames that are there are taken.
    medium : Medium or sequence of Medium
        One for all frames, or one per frame (`fade`). Path lengths and colour ranges that are open
        are measured in the first volume, and are the same in all frames.
    cameras : Camera or sequence of Camera
        One for all frames, or one per frame (`orbit`, `zoom`, `dolly`, `fly`, `keyframes`).
    path : str or Path
        ``.mp4`` (needs ``pip install "voluminous[movie]"``), ``.gif`` or ``.webp``; or a picture
        per frame: ``"orbit.png"`` writes ``orbit_0000.png`` and so on (more digits where the last
        frame needs them), likewise .exr, .fits, .tif and .npz; a name without a suffix, such as
        ``"frames/"``, is a directory, which is made, for ``0000.png`` and so on.
    fps : float
        Frames per second; at most 50 in a .gif, whose times are rounded to 10 ms.
    picture : dict, optional
        Options of `Image.save`, such as ``{"stretch": "asinh", "annotate": True}``. What decides
        brightness and colours (`exposure`, or the range of a colormap), and the unit of
        annotations, are the same in all frames: by default those that suit the whole film.
    project : dict, optional
        Arguments of `project`, such as ``{"quantity": "density", "how": "max"}``: every frame is
        this projection, and `medium` does not count. Grey without a colormap.
    finish : callable, optional
        Makes another image of each before it is saved: ``lambda image: image.anaglyph()``. It
        is identified by its code and by all values that it reads, not by files that it opens.
    codec : str
        Of an .mp4, one that FFmpeg knows: "libx264", "libsvtav1".
    keep_frames : bool
        Leave the pictures of which an .mp4, .gif or .webp is made.
    executor : concurrent.futures.Executor or Dask client, optional
        Draws and writes the frames in its processes, one by one in each, which see the same files.
        Paths are opened and functions called there; of volumes what is in memory is sent, up to
        8 MiB with each frame, any size with a Dask client.
    share : (int, int), optional
        ``(2, 8)`` draws the second of eight shares of the frames (2, 10, 18, …): for several
        programs side by side, without an executor. That which finds all frames made also writes
        the film, and the frames stay.
    progress : bool or callable, optional
        As in `render`, counted in frames. With an executor it is called five times a second; if it
        raises, frames that are not begun are cancelled.
    **options
        Those of `render`; `clip` may be a sequence too, with a region for each frame.

    Returns
    -------
    list of Path
        The files written: one, or one per frame; of a share its frames, or the film.

    Raises
    ------
    InputError
        If numbers of frames do not fit each other, or for anything that `render` refuses.
    VoluminousError
        With an executor, if a frame fails: with its number. Errors of files are tried three times
        more.

    Examples
    --------
    >>> import voluminous as vm
    >>> core = vm.models.prestellar_core(32)
    >>> medium = vm.suggest_medium(core)
    >>> cameras = vm.orbit(vm.Orthographic(60, 0, resolution=200), turns=1, frames=3)
    >>> [path.name for path in vm.movie(core, medium, cameras, "orbit.png")]
    ['orbit_0000.png', 'orbit_0001.png', 'orbit_0002.png']
    """
    target = as_path(path)
    suffix = target.suffix.lower()
    if suffix and suffix not in ENCODERS and suffix not in PICTURES:
        raise InputError(
            f"a film is a {', '.join(ENCODERS)}, a series of {', '.join(PICTURES)}, or a directory "
            f"for .png (a name without a suffix), got {target.name!r}"
        )
    check_fps(fps, suffix)
    if not isinstance(codec, str):
        raise InputError(f"codec must be a name such as 'libx264', got {codec!r}")
    check_options(options)
    picture = {} if picture is None else picture
    if project:
        # A film has one range for all frames, and grey shows it.
        picture = {"colormap": "gray", **picture} if isinstance(picture, dict) else picture
        medium, options = Coefficients(project["quantity"], 0), {**options, "project": project}
    film = _Film.of(volume, medium, cameras, options, picture, finish)
    mine = _share(share, film.count)
    paths = film.paths = _paths(target, film.count)
    remove_unfinished([*paths, target])
    report: Any = progress
    film.take(executor)
    if suffix not in ENCODERS or keep_frames:
        _name_others(paths)
    if suffix not in PICTURES or suffix == ".png":
        film.fix_display(lambda done: report(0, len(mine)))
    film.draw(mine, report)
    if executor is not None:
        remove_unfinished(paths)  # of workers that were killed
    if share is not None and not all(map(film.is_made, range(film.count))):
        return [paths[k] for k in mine]
    if suffix not in ENCODERS:
        return paths
    with replacing(target) as temporary:
        encode(paths, temporary, suffix, fps, codec)
    if not keep_frames and share is None:
        shutil.rmtree(paths[0].parent)
    return [target]


def _paths(target: Path, count: int) -> list[Path]:
    """Return where the frames are written; makes their directory."""
    digits = max(4, len(str(count - 1)))
    numbers = [f"{k:0{digits}d}" for k in range(count)]
    if target.suffix.lower() in PICTURES:
        return [target.with_name(f"{target.stem}_{k}{target.suffix}") for k in numbers]
    frames = target.with_name(f"{target.name}.frames") if target.suffix else target
    check_parent(target, frames)
    if frames.exists() and not frames.is_dir():
        raise InputError(f"{frames} is a file; give a directory for the frames, or a suffix")
    make_directory(frames)
    return [frames / f"{k}.png" for k in numbers]


def _name_others(paths: list[Path]) -> None:
    """Warn of frames that are no part of the film: other programs would take them for some."""
    first, ours = paths[0], {path.name for path in paths}
    pattern = re.compile(re.escape(first.stem.rstrip("0")) + r"\d{4,}" + re.escape(first.suffix))
    there = (path.name for path in first.parent.glob(f"*{first.suffix}"))
    if others := sorted(n for n in there if pattern.fullmatch(n) and n not in ours):
        warnings.warn(
            f"{first.parent} has {len(others)} more frames, of another film: "
            f"{', '.join(others[:_SAMPLES])}{' …' * (len(others) > _SAMPLES)}; remove them before "
            "other programs take all that are there",
            stacklevel=4,
        )


def _share(share: Any, count: int) -> range:
    if share is None:
        return range(count)
    if isinstance(share, tuple) and len(share) == 2 and all(is_count(n, 1 << 31) for n in share):
        number, shares = share
        if number <= shares:
            return range(number - 1, count, shares)
    raise InputError(f"share is a number and how many there are, such as (1, 8), got {share!r}")


@dataclass
class _Film:
    """What is drawn, one entry per frame, or one for all; where to, and by whom."""

    volumes: list[Any]
    media: list[Medium]
    cameras: list[Camera]
    clips: list[Any]
    options: dict[str, Any]
    given: dict[str, Any]
    finish: Callable[[Image], Image] | None
    count: int
    # Options of `Image.save`: those given, and those chosen for the whole film.
    picture: dict[str, Any]
    paths: list[Path] = field(default_factory=list)
    executor: Any = None
    # The volumes as the executor gets them.
    sources: list[Any] = field(default_factory=list)
    # Added to the provenance of all frames: whose display options they have.
    noted: dict[str, Any] = field(default_factory=dict)
    _opened: tuple[int, Volume] | None = None
    _hashes: dict[int, tuple[Any, str]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        volume: Any,
        medium: Any,
        cameras: Any,
        options: dict[str, Any],
        picture: dict[str, Any],
        finish: Callable[[Image], Image] | None,
    ) -> _Film:
        volumes, media, eyes = (
            list(one) if isinstance(one, (list, tuple)) else [one]
            for one in (volume, medium, cameras)
        )
        for kind, each in ((Medium, media), (Camera, eyes)):
            if wrong := [one for one in each if not isinstance(one, kind)]:
                raise InputError(f"a film is made with a {kind.__name__}, got {shown(wrong[0])}")
        if not (isinstance(picture, dict) and (finish is None or callable(finish))):
            wanted = "picture is a dict of options of Image.save, finish a function of an image"
            raise InputError(f"{wanted}, got {shown(picture)} and {shown(finish)}")
        if not (volumes and media and eyes):
            raise InputError("a film needs at least one volume, medium and camera")
        clip = options.get("clip")
        clips = list(clip) if isinstance(clip, (list, tuple)) else [clip]
        each = [one for one in (media, eyes, clips) if len(one) > 1]
        lengths = {len(one) for one in each} or {len(volumes)}
        if len(lengths) > 1 or not clips:
            raise InputError(
                f"a film needs one medium and one camera, or one for each frame, got {len(media)} "
                f"media and {len(eyes)} cameras{f', {len(clips)} clips' if clip else ''}"
            )
        sources = [_source(one) for one in volumes]
        if isinstance(picture.get("colormap"), str):  # which may be registered again
            picture = {**picture, "colormap": get_colormap(picture["colormap"])}
        others = {name: value for name, value in options.items() if name != "clip"}
        return cls(sources, media, eyes, clips, others, picture, finish, lengths.pop(), picture)

    def take(self, executor: Any) -> None:
        """Make ready what an executor gets; measure what is open in the media."""
        if executor is not None:
            self.executor = as_executor(executor)
            # Before anything is read: what is in memory would be sent.
            self.sources = [_sent(volume, executor) for volume in self.volumes]
        self.media = [medium.calibrated(self.volume(0)) for medium in self.media]

    def index(self, k: int) -> int:
        """Return which of the volumes a frame shows."""
        return k * len(self.volumes) // self.count

    def volume(self, k: int) -> Volume:
        """Return the volume of a frame; only one of a series is kept."""
        index = self.index(k)
        given = self.volumes[index]
        if isinstance(given, Volume):
            return given
        if self._opened is None or self._opened[0] != index:
            self._opened = None  # two of them may not fit
            self._opened = index, volume_of(given)
        return self._opened[1]

    def frame(self, k: int) -> Frame:
        medium, camera, clip = self._drawn(k)
        noted, options = {**self.noted, "frame": self.key(k)}, {**self.options, "clip": clip}
        return Frame(medium, camera, options, self.picture, self.finish, self.paths[k], noted)

    def _drawn(self, k: int) -> tuple[Any, ...]:
        each = self.media, self.cameras, self.clips
        return tuple(one[k if len(one) > 1 else 0] for one in each)

    def fix_display(self, report: Callable[[int], Any]) -> None:
        """Choose brightness, colour range and unit that are the same in all frames.

        Frames of the same film that are there tell what was chosen.
        """
        note = self.picture.get("annotate")
        if not isinstance(note, (bool, np.bool_, dict, type(None))):
            raise InputError(f"annotate is True or a dict of its options, got {shown(note)}")
        unit = note and "unit" not in (note if isinstance(note, dict) else self.picture)
        bright = not any(name in self.picture for name in _FIXED) and self.count > 1
        if not unit and not bright:
            return
        film = self.whole()
        chosen = next((c["options"] for c in self._noted() if c.get("film") == film), None)
        if chosen is None:
            few = np.unique(np.linspace(0, self.count - 1, _SAMPLES if bright else 1).astype(int))
            chosen = self._display(few.tolist(), report, unit, bright)
        self.noted = {"display": {"film": film, "options": chosen}}
        if "unit" in chosen:
            chosen = {
                **chosen,
                "annotate": {**(note if isinstance(note, dict) else {}), "unit": chosen["unit"]},
            }
        self.picture = self.given | {n: value for n, value in chosen.items() if n != "unit"}

    def _noted(self) -> Iterator[dict[str, Any]]:
        for path in self.paths:
            yield provenance(path).get("display") or {}

    def _display(
        self, numbers: list[int], report: Callable[[int], Any], unit: Any, bright: bool
    ) -> dict[str, Any]:
        lows, highs, exposures, units = zip(*self._each(display, numbers, report), strict=True)
        chosen: dict[str, Any] = {"unit": units[0]} if unit and units[0] else {}
        if bright and self.picture.get("colormap") is None:
            chosen["exposure"] = min(exposures)
        elif bright and max(highs) > min(lows):
            chosen |= {"vmin": min(lows), "vmax": max(highs)}
        return chosen

    def _each(
        self, function: Callable[..., Any], numbers: Sequence[int], report: Callable[[int], Any]
    ) -> list[Any]:
        if self.executor is not None:
            tasks = [(self.frame(k), self.sources[self.index(k)]) for k in numbers]
            names = [f"frame {k}" for k in numbers]
            done: dict[int, Any] = {}
            run_tasks(
                self.executor,
                lambda k: (function, *tasks[k]),
                done.__setitem__,
                names,
                lambda: report(len(done)),
            )
            return [done[k] for k in range(len(tasks))]
        return [function(self.frame(k), self.volume(k)) for k in numbers]

    def draw(self, numbers: Sequence[int], report: Callable[[int, int], Any]) -> None:
        """Draw and write some frames, but for those that are made."""
        lacking, made = [], 0
        for k in numbers:
            if self.is_made(k):
                made += 1
                report(made, len(numbers))
            else:
                lacking.append(k)
        if self.executor is not None:
            self._each(draw, lacking, lambda done: report(made + done, len(numbers)))
            return
        with ThreadPoolExecutor(1) as writer:  # one is written while the next is drawn
            written = None
            for done, k in enumerate(lacking):
                image = self.frame(k).image(self.volume(k))
                if written is not None:
                    written.result()
                written = writer.submit(image.save, self.paths[k], **self.picture)
                report(made + done + 1, len(numbers))
            if written is not None:
                written.result()

    def is_made(self, k: int) -> bool:
        return provenance(self.paths[k]).get("frame") == self.key(k)

    def key(self, k: int) -> str:
        """Return a hash of all that decides how a frame looks, the same in every process."""
        return content_key(self.content(self.index(k)), self._told(self._drawn(k)), self.noted)

    def whole(self) -> str:
        """Return a hash of all that decides the display options that are open."""
        contents = [self.content(k) for k in range(len(self.volumes))]
        return content_key(
            contents, self._told((*self.media, *self.cameras, *self.clips)), self.count
        )

    def content(self, index: int) -> str:
        """Return what tells one of the volumes from others."""
        return self._once(self.volumes[index], _content)

    def _told(self, drawn: Sequence[Any]) -> list[str]:
        how = self.options, self.given, self.finish
        return [self._once(part, content_key) for part in (*how, *drawn)]

    def _once(self, part: Any, tell: Callable[[Any], str]) -> str:
        """Return what tells a part of the film from others; asked once, it stays what it is."""
        if id(part) not in self._hashes:
            self._hashes[id(part)] = part, tell(part)
        return self._hashes[id(part)][1]


def _content(given: Any) -> str:
    """Return what tells a volume, or what a function returns, from others.

    A partial function of this package, such as `open`, is identified by its arguments, with the
    stamps of files among them; any other is called.
    """
    if isinstance(given, Volume) or not _is_ours(given):
        return volume_of(given).fingerprint()
    every = *given.args, *given.keywords.values()
    paths = [Path(one) for one in every if isinstance(one, (str, os.PathLike))]
    return content_key(given, [stamp(path) for path in paths if path.exists()])


def _is_ours(given: Any) -> bool:
    function = getattr(given, "func", None)
    return str(getattr(function, "__module__", "")).startswith("voluminous.")


def _source(given: Any) -> Any:
    """Return a volume, or a function that returns one: for a path that which opens it."""
    if isinstance(given, Volume) or callable(given):
        return given
    return functools.partial(open_volume, seen_from(Path.cwd(), str(as_path(given))))


def _sent(given: Any, executor: Any) -> Any:
    """Return a volume as an executor gets it: opened by its processes, or sent to them."""
    threads = isinstance(executor, ThreadPoolExecutor)
    scatter = getattr(executor, "scatter", None)  # of a Dask client
    if not isinstance(given, Volume):
        lambdas = threads or scatter is not None  # which can be sent there
        return given if lambdas and not _is_ours(given) else Sent.of(given, f"{given!r}")
    if threads:
        return given
    given = given.unread()
    size = sum(given.array(n).nbytes for n in given.fields if n not in given.waiting)
    if size <= _MOST_SENT:
        return Sent.of(functools.partial(_itself, given), "the volume")
    if scatter is not None:
        return scatter(given, broadcast=True, hash=False)
    raise InputError(
        f"fields in memory ({size / 2**20:.0f} MiB) would be sent to other processes with each "
        "frame: save the volume, as in volume.save('volume.zarr'), and give its path; only a Dask "
        "client sends them once"
    )


def _itself(volume: Volume) -> Volume:
    return volume
