"""JupyterLab and marimo, each started with a notebook of one cell; for tests and benchmarks."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

HOSTS = ("jupyterlab", "marimo")
# Until a server listens, and until a cell has run.
_SECONDS = 60.0


def is_installed(host: str) -> bool:
    """Return whether a host of notebooks is there."""
    return find_spec(host) is not None


@contextmanager
def notebook(host: str, code: str, folder: Path) -> Iterator[str]:
    """Start a host with a notebook whose one cell holds `code`; give its address.

    All that it writes is in `folder`.
    """
    start = {"jupyterlab": _jupyterlab, "marimo": _marimo}[host]
    with open(folder / f"{host}.log", "w", encoding="utf-8") as log:
        command, variables, address = start(code, folder)
        process = subprocess.Popen(
            [sys.executable, "-m", *command],
            cwd=folder,
            env={**os.environ, **variables},
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        try:
            yield _wait(process, address, folder / f"{host}.log")
        finally:
            process.terminate()
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def run_cell(host: str, page: Any) -> None:
    """Run the cell of a notebook that a page of Playwright shows; marimo does so by itself."""
    if host == "jupyterlab":
        cell, end = page.locator(".jp-CodeCell").first, time.monotonic() + _SECONDS
        number = cell.locator(".jp-InputPrompt").first
        while not (prompt := number.inner_text()).strip("[ ]:").isdigit():
            assert time.monotonic() < end
            if prompt == "[ ]:":  # before there is a kernel it is in vain
                cell.locator(".cm-content").click()
                page.keyboard.press("Control+Enter")
            page.wait_for_timeout(100)


def _jupyterlab(code: str, folder: Path) -> Any:
    cell = {
        "cell_type": "code",
        "execution_count": None,
        "id": "view",
        "metadata": {},
        "outputs": [],
        "source": code,
    }
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    book = {
        "cells": [cell],
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    (folder / "view.ipynb").write_text(json.dumps(book))
    command = ["jupyterlab", "--no-browser", "--allow-root", "--port=0"]
    names = {"JUPYTER_CONFIG_DIR": "config", "JUPYTER_RUNTIME_DIR": "runtime", "IPYTHONDIR": "home"}

    def address() -> str | None:
        for path in folder.glob("runtime/jpserver-*.json"):
            server = json.loads(path.read_text())  # which may be there before it listens
            if _listens(server["port"]):
                return f"{server['url']}doc/tree/view.ipynb?token={server['token']}"
        return None

    return command, {key: str(folder / name) for key, name in names.items()}, address


def _marimo(code: str, folder: Path) -> Any:
    *lines, last = code.strip().splitlines()
    body = "".join(f"    {line}\n" for line in [*lines, last, "return"])
    (folder / "view.py").write_text(
        f"import marimo\n\napp = marimo.App()\n\n\n@app.cell\ndef _():\n{body}"
    )
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = ["marimo", "run", "view.py", "--headless", "--no-token", f"--port={port}"]

    def address() -> str | None:
        return f"http://127.0.0.1:{port}/" if _listens(port) else None

    return command, {"XDG_CONFIG_HOME": str(folder), "XDG_STATE_HOME": str(folder)}, address


def _listens(port: int) -> bool:
    with socket.socket() as there:
        return there.connect_ex(("127.0.0.1", port)) == 0


def _wait(process: Any, address: Any, log: Path) -> str:
    end = time.monotonic() + _SECONDS
    while time.monotonic() < end and process.poll() is None:
        try:
            if found := address():
                return str(found)
        except ValueError:  # half of a file
            pass
        time.sleep(0.05)
    raise RuntimeError(f"{process.args} does not serve: {log.read_text()}")
