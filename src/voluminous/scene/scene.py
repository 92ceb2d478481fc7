"""`Scene`: the complete description of a picture, as plain values that can be saved."""

from __future__ import annotations

import copy
import functools
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import FileFormatError, InputError
from ..files import as_path, check_readable, missing, replacing, seen_from, url_of
from ..io.guard import placed
from . import settings
from .sections import (
    build_camera,
    build_medium,
    build_objects,
    image_options,
    plain_render,
    projection,
    read_source,
    render_options,
)
from .settings import plain_sections, relative_path, set_value, with_paths

if TYPE_CHECKING:
    from ..image import Image
    from ..volume import Volume


class Scene:
    """A volume, media, a camera, and options of rendering and saving.

    Parameters
    ----------
    settings : mapping
        The sections ``volume``, ``medium`` (a list) or ``project``, and optionally ``object`` (a
        list), ``camera``, ``render`` and ``image``, as in a scene file. Media, objects and cameras
        may also be given as Python objects.
    directory : str or Path
        Base directory of relative paths.
    volume : Volume, optional
        The volume of the section ``volume``, if already in memory; otherwise read when needed.

    Attributes
    ----------
    medium : Medium
        The sum of all media; of a scene with a projection alone, its quantity.
    projection : dict
        Arguments of `project`: the picture is a projection. Empty if it is one of the media.
    objects : list of SceneObject
        Stars, spheres, lines, …
    camera : Camera
        By default an `Orthographic` that frames the volume.
    render_options, image_options : dict
        Keyword arguments of `render` and `Image.save`.

    Raises
    ------
    UnknownNameError
        For an unknown section, key, type …; the message contains its place and the nearest name.
    InputError
        If a value is of the wrong kind or cannot be used.

    Examples
    --------
    >>> scene = Scene({
    ...     "volume": {"model": "sphere", "resolution": 8},
    ...     "medium": [{"type": "coefficients", "emissivity": "inside", "extinction": "inside"}],
    ... })
    >>> scene.render(precision="double").shape
    (400, 400, 1)
    """

    def __init__(
        self,
        settings: Mapping[str, Any],
        directory: str | Path = ".",
        *,
        volume: Volume | None = None,
    ) -> None:
        self.directory = as_path(directory)
        self._settings = plain_sections(settings)
        self._settings["render"] = plain_render(self._settings["render"])
        self._source = read_source(self._settings["volume"])
        self.projection = projection(self._settings["project"])
        media = self._settings["medium"] or [
            {"type": "coefficients", "emissivity": self.projection["quantity"], "extinction": 0}
        ]
        self.medium = build_medium(media)
        self.objects = build_objects(self._settings["object"])
        self.camera = build_camera(self._settings["camera"])
        self.render_options = render_options(self._settings["render"])
        last = [one.channel for one in self.objects if one.channel is not None]
        if self.projection and self.objects:
            raise InputError("a projection shows no objects: leave out [[object]] or [project]")
        channels = max([self.medium.channels, *(channel + 1 for channel in last)])
        channels = 1 if self.projection else channels
        self.image_options = image_options(self._settings["image"], channels)
        self._volume = volume

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Load the scene from a TOML file, or from an image that was rendered from a scene.

        Raises
        ------
        FileFormatError
            If the file is not TOML; the message contains line and column.
        VoluminousError
            If it is not a scene; the message contains file, section and key.
        """
        from ..image import Image
        from ..image.formats import FORMATS

        path = as_path(path)
        if any(path.suffix.lower() in form.suffixes for form in FORMATS):
            provenance = Image.load(path).provenance or {}
            with placed(path):
                if "scene" not in provenance:
                    raise InputError("this image carries no scene: it was not rendered from one")
                return cls(provenance["scene"], path.parent)
        text = text_of(path)
        with placed(path):
            return cls(settings.loads(text), path.parent)

    def volume(self) -> Volume:
        """Return the volume, which is read (or computed) on the first call.

        Raises
        ------
        VoluminousError
            If it cannot be read, or a derived field cannot be computed.
        """
        if self._volume is None:
            self._volume = self._source.build(self.directory)
        return self._volume

    def of_file(self, path: str | Path) -> Callable[[], Volume]:
        """Return a function that opens another file as the section ``volume`` says.

        For a series in time: ``vm.movie([scene.of_file(p) for p in paths], scene.medium, …)``.
        """
        return functools.partial(self._source.of_file, seen_from(Path.cwd(), str(as_path(path))))

    def render(self, **overrides: Any) -> Image:
        """Render the scene.

        Parameters
        ----------
        **overrides
            Arguments of `voluminous.render` that override those of the scene, and ``progress``.

        Returns
        -------
        Image
            Its provenance holds the scene, with absolute paths: ``Scene.load`` restores it from
            the saved image, in any directory.
        """
        from ..measuring.projections import drawn

        options = self.drawing(**overrides)
        image = drawn(self.volume(), self.medium, self.camera, self.projection, **options)
        carried = self.to_dict()
        if overrides.pop("objects", self.objects) is not self.objects:
            carried["object"] = [one.describe() for one in options["objects"]]
        carried["render"] = _storable({**self._settings["render"], **overrides})
        base = self.directory.absolute()
        carried = with_paths(carried, lambda path: url_of(Path(path)) or str(seen_from(base, path)))
        return image.replace(provenance={**(image.provenance or {}), "scene": carried})

    def drawing(self, **overrides: Any) -> dict[str, Any]:
        """Return all keyword arguments of `render`: with objects, and an image as background."""
        options = {**self.render_options, "objects": self.objects, **overrides}
        if isinstance(background := options.get("background"), str):
            options["background"] = self.background(background)
        return options

    def background(self, path: str) -> Image:
        """Load an image file; the path may be relative to the scene's directory."""
        from ..image import Image

        with placed("[render] background"):
            return Image.load(self.directory / os.path.expanduser(path))

    def replaced(self, changes: Mapping[str, Any]) -> Scene:
        """Return a scene with some values changed.

        Parameters
        ----------
        changes : mapping
            Keys and values, such as ``{"camera.incl": 40, "medium.2.opacity": 0.3}``; media
            count from 1. A key without a dot is a whole section.

        Raises
        ------
        UnknownNameError
            If a key does not exist; the message contains the nearest one.
        """
        settings = self.to_dict()
        for place, value in changes.items():
            set_value(settings, place, value)
        changed = Scene(settings, self.directory)
        if changed._settings["volume"] == self._settings["volume"]:
            changed._volume = self._volume
        return changed

    def to_dict(self, directory: str | Path | None = None) -> dict[str, Any]:
        """Return all sections as plain values, with paths relative to `directory` if given."""
        settings = copy.deepcopy({k: v for k, v in self._settings.items() if v})
        if directory is None:
            return settings
        return with_paths(
            settings, lambda path: relative_path(self.directory, path, Path(directory))
        )

    def dumps(self) -> str:
        """Return the scene as TOML."""
        return settings.dumps(self.to_dict())

    def save(self, path: str | Path) -> None:
        """Write a scene file with paths relative to its directory."""
        path = as_path(path)
        text = settings.dumps(self.to_dict(path.parent))
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def save_image(self, image: Image, path: str | Path) -> None:
        """Save a picture of this scene with those image options that the format supports."""
        from ..image.formats import format_of

        path = as_path(path)
        known = format_of(path).options
        image.save(path, **{k: v for k, v in self.image_options.items() if k in known})

    def __repr__(self) -> str:
        source = self._source.path or self._source.model
        return f"<Scene of {source}: {self.medium!r}, {self.camera!r}>"


def _storable(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of `render` that a file can hold; warn of the others.

    Scalars and flat lists can be held, arrays of an image's size cannot.
    """
    single = (str, bool, int, float)
    plain = plain_render({k: value for k, value in options.items() if k != "progress"})
    storable = {
        key: value
        for key, value in plain.items()
        if all(isinstance(v, single) for v in (value if isinstance(value, list) else [value]))
    }
    if others := [key for key in plain if key not in storable]:
        warnings.warn(
            f"the picture's scene is without {', '.join(others)}, which a file cannot hold: "
            "rendered from it the picture will be another",
            stacklevel=3,
        )
    return storable


def text_of(path: Path) -> str:
    """Return the text of a file, in UTF-8."""
    check_readable(path)
    try:
        return path.read_text(encoding="utf-8-sig")  # with a byte order mark, as on Windows
    except FileNotFoundError:
        raise missing(path) from None
    except UnicodeDecodeError as error:
        raise FileFormatError(
            f"{path}: expected a scene in TOML (UTF-8 text), byte {error.start} is none"
        ) from error
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
