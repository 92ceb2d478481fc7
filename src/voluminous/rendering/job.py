"""How light is traced through a volume, and everything that defines one render."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..backend import Backend, dr
from ..cameras.contract import Camera, Frame
from ..media.context import Tape
from ..media.contract import Medium
from ..packages import version
from ..progress import silent
from ..regions import Clip
from ..schemes.base import Scheme, is_controlled
from ..volume import Volume
from .cache import Cache
from .missing import HiddenCells
from .options import DEFAULT_ERROR
from .sources.cells import CellEvaluator

if TYPE_CHECKING:
    from .partition import Partition


@dataclass(kw_only=True)
class RayJob:
    """A medium in a volume, and how light is traced through it: along any rays.

    Attributes
    ----------
    rays : float
        About how many rays there are.
    hidden : HiddenCells, optional
        Cells that hold no value.
    clip : Clip, optional
        The part of space to which rays are confined.
    tape : Tape, optional
        Records the numbers of the medium, to differentiate by them.
    partition : Partition
        The blocks of cells that rays come to one after another.
    """

    volume: Volume
    medium: Medium
    rays: float
    scheme: Scheme
    backend: Backend
    cutoff: float | None
    tolerance: float
    cache: Cache
    partition: Partition
    hidden: HiddenCells | None = None
    clip: Clip | None = None
    tape: Tape | None = None

    @property
    def backward(self) -> bool:
        """Whether rays run towards the observer: as in RADMC-3D, with its sub-steps always."""
        return self.scheme.steps(self.volume.grid).backward

    @property
    def controlled(self) -> bool:
        """Whether the picture keeps to a tolerance, and has an error."""
        return is_controlled(self.scheme)

    @property
    def walk_kind(self) -> str:
        """The kind of walk through the grid that the scheme needs."""
        return self.scheme.steps(self.volume.grid).walk_kind

    @property
    def early_error(self) -> float:
        """Error allowed where a ray stops early, as a fraction of the intensity gathered."""
        return min(DEFAULT_ERROR, 0.1 * self.tolerance) if self.controlled else DEFAULT_ERROR

    def source(self, faintest: bool = False) -> Any:
        known = self.backend, self.cache.statistics, self.tape
        evaluator = CellEvaluator(self.volume, self.medium, *known)
        return self.partition.source(self, evaluator, faintest)

    def key(self, name: str, *others: Hashable) -> Hashable:
        """Return a key for what follows from medium, scheme and fields; None if one has no key."""
        parts = self.medium.key(), self.scheme.key(), *others
        statistics, names = self.cache.statistics, self.medium.names
        if None in parts or not statistics.is_hashed(names):
            return None
        return (
            name,
            *parts,
            self.backend,
            self.backward,
            self.tolerance,
            statistics.digests(names),
        )

    def provenance(self) -> dict[str, Any]:
        """Return the settings of the render, as plain values."""
        return {
            "software": f"voluminous {version()}",
            "scheme": self.scheme.name,
            "precision": self.backend.precision,
            "device": self.backend.device,
            "medium": self.medium.describe(),
            "color_bars": [bar for f in self.medium.known_features() for bar in f.color_bars()],
            "volume": self.volume.describe(),
            **({} if self.clip is None else {"clip": str(self.clip.region)}),
        }


@dataclass(kw_only=True)
class RenderJob(RayJob):
    """Everything that defines one render: its rays are those of a camera's pixels."""

    camera: Camera
    frame: Frame
    progress: Callable[[int, int], None]
    samples: int
    # More rays where the picture is not smooth; parts of pixels no wider than cells.
    adaptive: bool
    recursive: bool
    # Number of rays traced so far.
    done: int = 0

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs: it has its own cache."""
        return {**vars(self), "cache": None, "progress": silent}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.cache = Cache(self.volume)

    def take_double(self) -> None:
        """Continue in double precision."""
        self.backend, self.done = self.backend.with_precision("double"), 0

    def advance(self, rays: int, lanes: int) -> None:
        """Wait for rays and report them; interrupts take effect here."""
        dr.sync_thread()
        total = lanes * self.samples**2
        self.done = min(self.done + rays, total)
        self.progress(self.done, total)
