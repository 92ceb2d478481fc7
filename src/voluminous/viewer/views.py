"""`view`: the explorer for a volume, in a notebook's cell or in a browser."""

from __future__ import annotations

import base64
import contextlib
import sys
from pathlib import Path
from typing import Any

from ..cameras import Camera
from ..errors import VoluminousError
from ..image import Image
from ..media import Medium
from ..progress import in_jupyter
from ..scene import Scene
from .explorer import Explorer
from .page import Server
from .painter import at_hand
from .widget import make_widget

# Pixels of the picture in a saved notebook.
_SAVED = 400


class View:
    """An explorer that is open.

    Attributes
    ----------
    medium : Medium
        What is drawn now.
    camera : Camera
        From where the page that moved last looks.
    scene : Scene
        All of it; `Scene.save` writes a file.
    url : str or None
        The page's address, in a browser.
    """

    def __init__(self, explorer: Explorer, server: Server | None, widget: Any) -> None:
        self._explorer, self._server, self._widget = explorer, server, widget

    @property
    def medium(self) -> Medium | None:
        return self._explorer.medium

    @property
    def camera(self) -> Camera:
        return self._explorer.camera

    @property
    def scene(self) -> Scene:
        return self._explorer.scene()

    @property
    def url(self) -> str | None:
        return None if self._server is None else self._server.url

    def image(self, resolution: Any = None, **options: Any) -> Image:
        """Render what is on the screen.

        Parameters
        ----------
        resolution : int or (int, int), optional
            Pixels; 400 by default. Of a panorama, a dome or a picture for two eyes: the most that
            fit into them.
        **options
            Those of `render`.
        """
        return self._explorer.scene(resolution).render(**options)

    def close(self) -> None:
        """End the page and its server."""
        if self._server is not None:
            self._server.close()
        self._explorer.close()

    def _repr_mimebundle_(self, **options: Any) -> Any:
        if self._widget is None:
            return {"text/plain": repr(self)}
        made = self._widget._repr_mimebundle_(**options)
        bundle, facts = made if isinstance(made, tuple) else (made, {})
        with contextlib.suppress(VoluminousError):  # where no kernel runs a saved notebook shows it
            scene = self._explorer.scene(_SAVED)
            quick = {} if scene.projection else {"tolerance": None, "progress": False}
            scene = Scene(scene.to_dict(), volume=at_hand(self._explorer.volume))
            png = scene.render(**quick)._repr_png_()
            bundle = {**bundle, "image/png": base64.b64encode(png).decode()}
        return bundle, facts

    def __repr__(self) -> str:
        return f"<View at {self.url}>" if self.url else "<View in this notebook>"


def view(
    volume: Any,
    medium: Medium | None = None,
    camera: Camera | None = None,
    *,
    notebook: bool | None = None,
    browser: bool = True,
    port: int = 0,
    **options: Any,
) -> View:
    """Open the explorer: turn a volume, edit its media, click pixels, save pictures and scenes.

    Parameters
    ----------
    volume : Volume, Scene, path, or sequence of volumes or paths
        What is seen; a sequence is a series in time.
    medium : Medium, optional
        By default `suggest_medium` finds one.
    camera : Camera, optional
        By default what the medium shows, from obliquely above.
    notebook : bool, optional
        Show it in the notebook's cell; by default where there is a notebook.
    browser : bool
        Open the page, where there is no notebook.
    port : int
        Of the page; by default any that is free.
    **options
        Those of `render`, such as ``tolerance``.

    Returns
    -------
    View
        What is on the screen, as values.

    Raises
    ------
    MissingPackageError
        Without ``pip install "voluminous[view]"``.
    """
    settings: dict[str, Any] = {"render": options}
    if isinstance(volume, Scene):
        scene = volume
        given = scene.to_dict()
        settings = {**given, "render": {**given.get("render", {}), **options}}
        volume = scene.volume()
        medium = scene.medium if medium is None else medium
        camera = scene.camera if camera is None else camera
    elif isinstance(volume, (str, Path)) and str(volume).endswith(".toml"):
        return view(
            Scene.load(volume),
            medium,
            camera,
            notebook=notebook,
            browser=browser,
            port=port,
            **options,
        )
    explorer = Explorer(volume, medium, camera, settings)
    if notebook is None:
        notebook = in_jupyter() or "marimo" in sys.modules
    if notebook:
        return View(explorer, None, make_widget(explorer))
    server = Server(explorer, port=port)
    server.start()
    if browser:
        server.open_browser()
    return View(explorer, server, None)
