"""Pictures of the guide to the explorer: what a browser shows, of a page and of a notebook."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from figures_data import data_folder
from PIL import Image as Pillow

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
import chromium
import notebook_hosts

COLLAPSE = "athena_turb_collapse/TurbCollapse_t1.607.athdf"


@contextmanager
def page(width: int, height: int) -> Iterator[Any]:
    """Give a page of Playwright."""
    if find_spec("playwright") is None or chromium.PATH is None:
        raise FileNotFoundError("there is no playwright, or no chromium")
    with chromium.launched() as browser:
        shown = browser.new_page(viewport={"width": width, "height": height})
        shown.set_default_timeout(120_000)
        yield shown


def rest(shown: Any) -> None:
    """Wait for the exact picture."""
    shown.wait_for_timeout(300)
    shown.wait_for_selector("[data-exact=true]", state="attached")
    shown.wait_for_timeout(1000)


def save(shown: Any, target: Path) -> None:
    """Save what a page shows as a small WebP file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "page.png"
        shown.screenshot(path=path)
        Pillow.open(path).convert("RGB").save(target, "WEBP", quality=80, method=6)


def explored(act: Callable[[Any], None]) -> Callable[[Path, int], None]:
    """Return what opens real data, does something and saves what is seen."""

    def make(target: Path, pixels: int) -> None:
        import voluminous as vm

        path = data_folder() / COLLAPSE
        volume = path if path.exists() else vm.models.prestellar_core(48)
        with page(1000, 640) as shown:
            view = vm.view(volume, notebook=False, browser=False)
            shown.goto(view.url)
            rest(shown)
            act(shown)
            save(shown, target)
            view.close()

    return make


def click(shown: Any) -> None:
    """Click a bright pixel, and open the panel of its ray."""
    box = shown.locator("canvas").first.bounding_box()
    shown.mouse.click(box["x"] + 0.62 * box["width"], box["y"] + 0.5 * box["height"])
    shown.get_by_role("tab", name="Ray").click()
    shown.get_by_role("tabpanel", name="Ray").locator("svg, canvas").first.wait_for()
    shown.wait_for_timeout(1000)


def hover(shown: Any) -> None:
    """Hold the pointer over values of the histogram."""
    panel = shown.get_by_role("tabpanel", name="Media").locator("svg, canvas").first
    box = panel.bounding_box()
    shown.mouse.move(box["x"] + 0.78 * box["width"], box["y"] + 0.7 * box["height"])
    shown.wait_for_timeout(4000)


def views(shown: Any) -> None:
    """Keep two views, and open the panel that makes films of them."""
    shown.locator("canvas").first.focus()
    shown.keyboard.press("Shift+Digit1")
    for key in ("+", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowDown"):
        shown.keyboard.press(key)
        shown.wait_for_timeout(300)
    rest(shown)
    shown.keyboard.press("Shift+Digit2")
    shown.get_by_role("tab", name="Views").click()
    shown.wait_for_timeout(1500)


def slices(target: Path, pixels: int) -> None:
    """A head CT with three slices, bone and brain as labels, beside its picture."""
    import numpy as np

    import real_data
    import voluminous as vm

    volume = real_data.load("cranium")
    volume.meta["orientation"] = "RAS"
    ct = volume.array("ct")
    bone, brain = ct > 250, (ct > 15) & (ct < 60)
    volume["parts"] = (bone + 2 * brain).astype(np.uint8)
    with page(1000, 640) as shown:
        view = vm.view(volume, vm.presets.bone(volume), notebook=False, browser=False)
        shown.goto(view.url)
        rest(shown)
        shown.get_by_role("tab", name="Slices").click()
        shown.get_by_role("checkbox", name="three slices").check()
        shown.get_by_label("Labels").select_option("parts")
        shown.wait_for_timeout(2000)
        box = shown.locator(".vlm-pane").first.bounding_box()
        shown.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 0.4 * box["height"])
        rest(shown)
        save(shown, target)
        view.close()


def notebook(target: Path, pixels: int) -> None:
    """The explorer in a cell of JupyterLab."""
    if not notebook_hosts.is_installed("jupyterlab"):
        raise FileNotFoundError("there is no jupyterlab")
    path = data_folder() / COLLAPSE
    opened = f'vm.open("{path.name}")' if path.exists() else "vm.models.prestellar_core(48)"
    code = f"import voluminous as vm\n\nvolume = {opened}\nview = vm.view(volume)\nview"
    with tempfile.TemporaryDirectory() as folder, page(1000, 860) as shown:
        if path.exists():
            (Path(folder) / path.name).symlink_to(path.resolve())
        with notebook_hosts.notebook("jupyterlab", code, Path(folder)) as address:
            shown.goto(address)
            notebook_hosts.run_cell("jupyterlab", shown)
            rest(shown)
            if (no := shown.get_by_role("button", name="No")).count():
                no.first.click()  # news
            shown.locator("canvas").first.scroll_into_view_if_needed()
            shown.wait_for_timeout(1500)
            save(shown, target)


EXPLORER_FIGURES: dict[str, Callable[[Path, int], None]] = {
    "explorer_page": explored(lambda shown: None),
    "explorer_ray": explored(click),
    "explorer_values": explored(hover),
    "explorer_views": explored(views),
    "explorer_slices": slices,
    "explorer_notebook": notebook,
}
