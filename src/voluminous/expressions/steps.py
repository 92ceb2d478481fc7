"""Which steps of a function a value needs: see `tree.Steps`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from .tree import Earlier, Node, Steps, nodes


def in_steps(steps: Sequence[Node], result: Node) -> Node:
    """Return a result with the steps that it needs, no others: the same for the same formula."""
    needed: set[int] = set()
    waiting = [result]
    while waiting:
        for number in _earlier(waiting.pop()):
            if number not in needed:
                needed.add(number)
                waiting.append(steps[number])
    if not needed:
        return result
    new = {old: k for k, old in enumerate(sorted(needed))}
    return Steps(tuple(_renumbered(steps[old], new) for old in new), _renumbered(result, new))


def _earlier(node: Node) -> list[int]:
    return [below.step for below in nodes(node) if isinstance(below, Earlier)]


def _renumbered(node: Any, new: dict[int, int]) -> Any:
    if isinstance(node, tuple):
        return tuple(_renumbered(part, new) for part in node)
    if isinstance(node, Earlier):
        return Earlier(new[node.step])
    if not isinstance(node, Node) or not _earlier(node):
        return node
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node)}  # type: ignore[arg-type]
    return type(node)(**{name: _renumbered(value, new) for name, value in parts.items()})
