"""Films: every frame a picture in a file; then all of them one file, if that is asked for."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras import Camera
from ..cameras.contract import pixel_counts
from ..errors import InputError
from ..files import as_path, replacing, unfinished
from ..image import Image
from ..image.annotate.marks import readable_unit
from ..io import open as open_volume
from ..media.contract import Medium
from ..progress import Progress, with_progress
from ..rendering import render
from ..volume import Volume
from .encode import ENCODERS, encode

PICTURES = (".png", ".exr", ".fits", ".tif", ".tiff", ".npz")
# Frames that are drawn first, coarsely, to find the exposure of all.
_SAMPLES, _COARSE = 16, 100
# Display options that fix the brightness.
_FIXED = ("exposure", "vmin", "vmax", "norm")


@with_progress
def movie(
    volume: Any,
    medium: Any,
    cameras: Camera | Sequence[Camera],
    path: str | Path,
    *,
    fps: float = 30.0,
    picture: dict[str, Any] | None = None,
    finish: Callable[[Image], Image] | None = None,
    codec: str = "libx264",
    keep_frames: bool = False,
    progress: Progress = None,
    **options: Any,
) -> list[Path]:
    """Render a film.

    Frames are written one by one, each whole. A film that was interrupted goes on where it was: the
    same call makes only what is missing, or was made with other arguments.

    Parameters
    ----------
    volume : Volume, path, or sequence of them
        A sequence is a series in time, opened one by one; it is spread evenly over the frames.
    medium : Medium or sequence of Medium
        One for all frames, or one per frame (`fade`). Path lengths and colour ranges that are open
        are measured in the first volume, and are the same in all frames.
    cameras : Camera or sequence of Camera
        One for all frames, or one per frame (`orbit`, `zoom`, `dolly`, `fly`, `keyframes`).
    path : str or Path
        ``.mp4`` (needs ``pip install "voluminous[movie]"``), ``.gif`` or ``.webp``; or a picture
        per frame: ``"orbit.png"`` writes ``orbit_0000.png`` and so on, likewise .exr, .fits,
        .tif and .npz.
    fps : float
        Frames per second.
    picture : dict, optional
        Options of `Image.save`, such as ``{"stretch": "asinh", "annotate": True}``. What decides
        brightness and colours (`exposure`, or the range of a colormap), and the unit of
        annotations, are the same in all frames: by default those that suit the whole film.
    finish : callable, optional
        Makes another image of each before it is saved: ``lambda image: image.anaglyph()``.
    codec : str
        Of an .mp4, one that FFmpeg knows: "libx264", "libsvtav1".
    keep_frames : bool
        Leave the pictures of which an .mp4, .gif or .webp is made.
    progress : bool or callable, optional
        As in `render`, counted in frames.
    **options
        Those of `render`.

    Returns
    -------
    list of Path
        The files written: one, or one per frame.

    Raises
    ------
    InputError
        If numbers of frames do not fit each other, or for anything that `render` refuses.

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
    if suffix not in ENCODERS and suffix not in PICTURES:
        raise InputError(
            f"a film is a {', '.join(ENCODERS)} or a series of {', '.join(PICTURES)}, got "
            f"{target.name!r}"
        )
    film = _Film.of(volume, medium, cameras, options, dict(picture or {}), finish)
    if suffix == ".png" or suffix in ENCODERS:
        film.fix_display()
    if suffix in PICTURES:
        frames = target.parent
        names = [f"{target.stem}_{k:04d}{target.suffix}" for k in range(film.count)]
    else:
        frames = target.with_name(f"{target.name}.frames")
        names = [f"{k:04d}.png" for k in range(film.count)]
        frames.mkdir(exist_ok=True)
    paths = [frames / name for name in names]
    _remove_partial([*paths, target])
    report: Any = progress
    _draw(film, paths, report)
    if suffix in PICTURES:
        return paths
    with replacing(target) as temporary:
        encode(paths, temporary, suffix, fps, codec)
    if not keep_frames:
        shutil.rmtree(frames)
    return [target]


@dataclass
class _Film:
    """What is drawn: one entry per frame, or one for all."""

    volumes: list[Any]
    media: list[Medium]
    cameras: list[Camera]
    options: dict[str, Any]
    picture: dict[str, Any]
    finish: Callable[[Image], Image] | None
    count: int
    _opened: tuple[int, Volume] | None = None
    _contents: dict[int, list[Any]] = field(default_factory=dict)

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
        if not (volumes and media and eyes):
            raise InputError("a film needs at least one volume, medium and camera")
        lengths = {len(each) for each in (media, eyes) if len(each) > 1} or {len(volumes)}
        if len(lengths) > 1:
            raise InputError(
                f"a film needs one medium and one camera, or one for each frame, got {len(media)} "
                f"media and {len(eyes)} cameras"
            )
        film = cls(volumes, media, eyes, options, picture, finish, lengths.pop())
        film.media = [medium.calibrated(film.volume(0)) for medium in media]
        return film

    def volume(self, k: int) -> Volume:
        """Return the volume of a frame; only one of a series is kept."""
        index = k * len(self.volumes) // self.count
        if not isinstance(self.volumes[index], Volume):
            if self._opened is None or self._opened[0] != index:
                self._opened = index, open_volume(self.volumes[index])
            return self._opened[1]
        one: Volume = self.volumes[index]
        return one

    def medium(self, k: int) -> Medium:
        return self.media[k if len(self.media) > 1 else 0]

    def camera(self, k: int) -> Camera:
        return self.cameras[k if len(self.cameras) > 1 else 0]

    def image(self, k: int, camera: Camera | None = None, **options: Any) -> Image:
        camera = camera or self.camera(k)
        image = render(
            self.volume(k), self.medium(k), camera, progress=False, **{**self.options, **options}
        )
        return image if self.finish is None else self.finish(image)

    def fix_display(self) -> None:
        """Choose brightness, colour range and unit that are the same in all frames."""
        note = self.picture.get("annotate")
        if note and "unit" not in (note if isinstance(note, dict) else self.picture):
            unit = readable_unit(self.image(0, _coarse(self.camera(0)), tolerance=None))
            if unit:
                self.picture["annotate"] = {
                    **(note if isinstance(note, dict) else {}),
                    "unit": unit,
                }
        if any(name in self.picture for name in _FIXED) or self.count == 1:
            return
        ends, exposures = [], []
        for k in np.unique(np.linspace(0, self.count - 1, _SAMPLES).astype(int)):
            image = self.image(int(k), _coarse(self.camera(int(k))), tolerance=None)
            finite = image.intensity[np.isfinite(image.intensity)]
            ends.append((finite.min(), finite.max()))
            exposures.append(image.exposure)
        low, high = float(min(e[0] for e in ends)), float(max(e[1] for e in ends))
        if self.picture.get("colormap") is None:
            self.picture["exposure"] = min(exposures)
        elif high > low:
            self.picture |= {"vmin": low, "vmax": high}

    def key(self, k: int) -> str:
        """Return a hash of all that decides how a frame looks."""
        index = k * len(self.volumes) // self.count
        given = self.volumes[index]
        if index not in self._contents:
            content: list[Any]
            if isinstance(given, Volume):
                content = [given.digest(name).hex() for name in given.fields]
            else:
                stat = Path(given).stat()
                content = [str(given), stat.st_size, stat.st_mtime_ns]
            self._contents[index] = content
        told = (
            self._contents[index],
            repr(self.medium(k)),
            repr(self.camera(k)),
            self.options,
            self.picture,
        )
        return hashlib.sha256(json.dumps(told, default=repr).encode()).hexdigest()[:32]


def _coarse(camera: Camera) -> Camera:
    """Return a camera with few pixels of about the same shape."""
    pair = pixel_counts(camera.arguments().get("resolution", _COARSE))
    if max(pair) <= _COARSE:
        return camera
    nx, ny = (max(1, round(n * _COARSE / max(pair))) for n in pair)
    return camera.within((nx, ny))


def _draw(film: _Film, paths: list[Path], report: Callable[[int, int], None]) -> None:
    """Render and write all frames that are missing; one is written while the next is rendered."""
    with ThreadPoolExecutor(1) as writer:
        written = None
        for k, path in enumerate(paths):
            key = film.key(k)
            if not _is_made(path, key):
                image = film.image(k)
                image = image.replace(provenance={**(image.provenance or {}), "frame": key})
                if written is not None:
                    written.result()
                written = writer.submit(image.save, path, **film.picture)
            report(k + 1, film.count)
        if written is not None:
            written.result()


def _is_made(path: Path, key: str) -> bool:
    if not path.is_file():
        return False
    try:
        provenance = _provenance(path)
    except Exception:  # damaged, or no picture of ours: made again
        return False
    return provenance.get("frame") == key


def _provenance(path: Path) -> dict[str, Any]:
    if path.suffix.lower() != ".png":
        return Image.load(path).provenance or {}
    from PIL import Image as Pillow

    from ..image import metadata

    with Pillow.open(path) as file:  # reads the texts, not the pixels
        text = file.info.get(metadata.KEY)
        size = file.size
    return metadata.loads(text, (size[1], size[0], 3)).get("provenance") or {}


def _remove_partial(paths: list[Path]) -> None:
    """Remove what a film left that was killed while it wrote a file."""
    for path in paths:
        for left in unfinished(path):
            left.unlink(missing_ok=True)
