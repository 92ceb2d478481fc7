"""The explorer in a notebook: the same page over the notebook's own channel, by anywidget."""

from __future__ import annotations

import json
from importlib import resources
from typing import Any

from ..packages import require
from .explorer import Explorer


def make_widget(explorer: Explorer) -> Any:
    """Return a widget that shows an explorer in Jupyter, VS Code, marimo or Colab."""
    anywidget = require("anywidget", "view", "the explorer in a notebook")
    folder = resources.files(__package__) / "static"

    class Widget(anywidget.AnyWidget):  # type: ignore[name-defined]
        """Moves messages between the explorer and a notebook."""

        _esm = (folder / "explorer.js").read_text(encoding="utf-8")
        _css = (folder / "explorer.css").read_text(encoding="utf-8")

        def __init__(self) -> None:
            super().__init__()
            self._client = explorer.connect(self._pass_on)
            self.on_msg(self._receive)

        def _pass_on(self, message: dict[str, Any], payload: bytes) -> None:
            self.send(json.loads(json.dumps(message)), [payload] if payload else [])

        def _receive(self, widget: Any, content: Any, buffers: Any) -> None:
            self._client.receive(content)

    return Widget()
